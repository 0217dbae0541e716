"""For every test: one BLAS thread, and the same examples of hypothesis in every run.

The matrices are small; more threads only wait. With HYPOTHESIS_PROFILE=explore hypothesis looks for
new examples.
"""

import os

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
