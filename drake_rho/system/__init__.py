"""Plumbing below all rooms: threads, and files that are written whole or not at all.

It knows nothing of scenarios or plans.
"""
