"""Entries of the report of one real-time period: an array (8 + l,) for a tool of l coordinates."""

STATUS = 0  # 0, or 1 if the period failed
TRUST = 1
STEPS = 2  # steps or iterations in the period
KINETIC, STRAIN = 3, 4  # energies [J]
FORCES = 8  # first of the generalised forces of the tool on the body
