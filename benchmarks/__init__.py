"""How fast the program is, beside its peers and beside what the machine allows. See docs/performance.md."""
