"""For every test: one BLAS thread. The matrices are small; more threads only wait."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
