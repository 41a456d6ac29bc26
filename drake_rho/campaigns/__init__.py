"""Campaigns: studies of many runs, the store of their results, and statistics over them."""
