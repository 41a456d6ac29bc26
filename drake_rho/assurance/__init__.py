"""Whether a plan holds: its verification, and the paper's study with its claims."""
