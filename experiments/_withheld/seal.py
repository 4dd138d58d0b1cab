"""Labels hidden before any diagnosis and opened after: digest = sha256(salt + labels as sorted JSON).

Whoever noted the printed digest can check that the opened labels, with the opened salt, give the same one.
"""

import hashlib
import json
import secrets
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Sealed:
    """Labels by case key, and the salt that keeps the digest from being guessed; neither is shown by `repr`."""

    labels: dict[str, str] = field(repr=False)
    salt: str = field(default_factory=lambda: secrets.token_hex(16), repr=False)

    @property
    def digest(self) -> str:
        """What is printed before the diagnoses."""
        return hashlib.sha256((self.salt + json.dumps(self.labels, sort_keys=True)).encode()).hexdigest()


def opened(labels: dict[str, str], salt: str, digest: str) -> dict[str, str]:
    """The labels, if they are the sealed ones.

    Raises:
        ValueError: labels or salt give another digest.
    """
    if Sealed(labels, salt).digest != digest:
        raise ValueError("these labels are not the ones that were sealed")
    return labels
