"""Many runs: studies, the store of what they found, and what it says."""
