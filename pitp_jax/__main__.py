"""`python -m pitp_jax` is the command `pitp`."""

import sys

from .cli import main

sys.exit(main())
