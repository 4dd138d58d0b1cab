"""`python -m pitp_jax` is the command `pitp`."""

import sys

from .application.commands.main import main

sys.exit(main())
