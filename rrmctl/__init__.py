"""The program around `rrm`: plans, runs, resumes, stores and reports experiments."""
