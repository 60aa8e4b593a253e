"""Files that appear whole or not at all: atomic replacement, output transactions, text files.

May use core's records alone.
"""
