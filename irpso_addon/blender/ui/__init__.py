"""The panels of the sidebar, one file each, and thumbnails.

Reads state, changes none.
"""
