"""What to photograph next: which dose and pattern would tell most."""
