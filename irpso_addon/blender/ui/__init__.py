"""The panels of the sidebar, one file each.

Reads state, changes none.
"""
