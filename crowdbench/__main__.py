"""Lets `python -m crowdbench` run the `crowdbench` command."""

import sys

from crowdbench.cli import main

sys.exit(main())
