"""Every table and figure of Liu, Zhu, Yan, Wang, Hong (2018), Tribology International 122, 169–178, beside ours.

python -m experiments.paper [NUMBER …] [--out DIR] [--page FILE]   (default docs/paper and docs/paper.md)
"""

import os

# XLA reports its own tuning hints as missing processor features whenever it loads a kept program
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
