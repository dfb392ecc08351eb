"""What a map is: poses, scans, rays, evidence, tiles, grids.

Values and pure functions over NumPy arrays. Nothing here opens a file, reads a clock, starts a thread or draws
a random number, and nothing here knows that there is a network.
"""
