"""Teachers answer queries. Named ones are here, as fields of `TeacherConfig`."""

from typing import Any

#: The paper's by name (section 4.4, appendix "Noisy teacher models"), B-Pref's others, and people.
TEACHERS: dict[str, dict[str, Any]] = {
    "oracle": {},
    "stochastic": {"beta": 1.0},
    "mistaken-10": {"mistake": 0.1},
    "mistaken-15": {"mistake": 0.15},
    "skipping": {"skip": 0.1},
    "equal": {"equal": 0.1},
    "myopic": {"gamma": 0.9},
    "human": {"kind": "human"},
}
