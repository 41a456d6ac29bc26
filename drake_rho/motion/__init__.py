"""What a flight is: its dynamics, and records of what was planned and flown."""
