"""Planning problems: scenario records and the files that store them."""
