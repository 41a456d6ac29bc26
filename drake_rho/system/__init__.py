"""Utilities below all other packages: threads, and files written completely or not at all.

It knows nothing of scenarios or plans.
"""
