"""`python -m hapnet`."""

import sys

from hapnet.cli import main

sys.exit(main())
