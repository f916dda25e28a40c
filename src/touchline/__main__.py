"""`python -m touchline`: the command without its entry point."""

import sys

from touchline.cli import main

sys.exit(main())
