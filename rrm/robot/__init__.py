"""A policy on an arm: cameras and their calibration, where the cube is, the robot's seam, a simulated rig, episodes.

Nothing here imports torch; only the rig's own process imports PyBullet.
"""
