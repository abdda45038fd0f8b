"""What all tests share: one torch thread, no renderer, no trace in a home, and no deadlines, whatever the load."""

import os
import tempfile

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MUJOCO_GL", "disabled")  # read when mujoco is first imported
os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp()  # what code was run is kept there

import hypothesis

hypothesis.settings.register_profile("unhurried", deadline=None)
hypothesis.settings.load_profile("unhurried")
