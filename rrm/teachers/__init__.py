"""Teachers answer queries. Named presets of the scripted one are here, as fields of `TeacherConfig`."""

#: The paper's teachers by name (section 4.4, appendix "Noisy teacher models"), and B-Pref's others.
TEACHERS: dict[str, dict[str, float]] = {
    "oracle": {},
    "stochastic": {"beta": 1.0},
    "mistaken-10": {"mistake": 0.1},
    "mistaken-15": {"mistake": 0.15},
    "skipping": {"skip": 0.1},
    "equal": {"equal": 0.1},
    "myopic": {"gamma": 0.9},
}
