"""Long Monte Carlo runs: every figure of the README is re-made here."""
