"""Small scenes with known truth: the painted vase of the demo, the square of the self-test.

May use core's records and core.shading.
"""
