"""python -m yapp_tables."""

import sys

from .cli import main

sys.exit(main())
