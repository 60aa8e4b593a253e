"""Observations to roughness: the model ladder, the search, neighbours, the paper's swarm, live read-back.

May use gpu.observe and the rooms below it.
"""
