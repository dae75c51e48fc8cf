"""Sample objects and scans with known truth: what `generate.py` writes, and the library it is written with."""
