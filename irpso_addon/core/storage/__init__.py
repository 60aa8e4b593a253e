"""Files that appear whole or not at all: atomic replacement, output transactions, .npz archives of records, text files.

May use core's records alone.
"""
