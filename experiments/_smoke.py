"""Name the effects that a quick diagnosis (`--smoke`) leaves out."""

from pitp_jax.method.effects import CATALOGUE


def all_but(*names: str) -> list[str]:
    """Return the names of all effects but these, which a quick diagnosis excludes."""
    return sorted({form.name for form in CATALOGUE} - set(names))
