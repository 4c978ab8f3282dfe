"""`python -m crowdbench` is `crowdbench`."""

import sys

from crowdbench.cli import main

sys.exit(main())
