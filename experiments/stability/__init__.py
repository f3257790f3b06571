"""Hard cases: what happens where numbers, files and scenes are as bad as they can be, counted and written on a page.

python -m experiments.stability                     all of it
python -m experiments.stability hazards contacts    some of `hazards`, `map`, `contacts`, `scenes`, `files`
python -m experiments.stability --small             in seconds, counts that prove nothing

It writes docs/stability.md, and the page's figure and numbers into docs/stability; what is not asked for is taken from
the numbers of the run before.
"""

import os

# as for experiments/paper
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
