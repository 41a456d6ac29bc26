"""What is asked: records of a scenario, and the files that hold them."""
