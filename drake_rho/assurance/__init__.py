"""What is proved: certificates of optimality for plans, and reasons why there is no plan."""
