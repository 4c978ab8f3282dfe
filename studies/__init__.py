"""Studies: what the pages of results say, and how it was measured. They need a clone.

Run them as `python -m studies NAME` in the root of the repository; nothing that is installed
imports them.
"""

import os

# Maps are photographs of others, which must not get into the pages of this repository.
os.environ["CROWDBENCH_MAPS"] = "off"
