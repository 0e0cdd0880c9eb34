"""Soft tissue: elastic sheets, their contacts with tools, and their drawings."""
