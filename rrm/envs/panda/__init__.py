"""A simulated Franka Panda at a table with a cube: PyBullet, with `pip install 'rrmctl[robot]'`."""
