"""Lamps and exposures put right by what the pictures show, where left-out views are then predicted better.

May use core's records, core.shading, core.evaluation and core.checks.light_checks; pure functions of arrays.
"""
