"""How arguments are checked while the tests run: by beartype, an int where a float is wanted being fine (PEP 484)."""

from beartype import BeartypeConf, beartype

check = beartype(conf=BeartypeConf(is_pep484_tower=True))
