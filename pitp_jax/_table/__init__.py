"""Tables: turns files of every format into columns with names, units and numbers, and chooses the columns.

    file -> guard (size, links, archives) -> tables that its bytes may mean -> choice of time, input and output

What is certain is recognised, the rest is asked for with the command that answers, and what the user says wins.
"""

from .columns import Loaded as Loaded
from .columns import load_columns as load_columns
from .options import ReadOptions as ReadOptions
from .refusal import Refused as Refused
from .refusal import together as together
