"""Pass, warn or refuse: figures held against limits, the same way for every calibration."""

import math
from typing import Any, Dict, List, Mapping, NamedTuple, Sequence

PASS, WARN, REFUSE = "pass", "warn", "refuse"
_ORDER = (PASS, WARN, REFUSE)


class Limit(NamedTuple):
    """A figure and what it may be; beyond ``warn`` or ``refuse`` the verdict says ``text``.

    ``text`` is a format that gets the value, e.g. ``"residual {:.2f} px"``. With ``is_floor``
    larger is better. A value that is not a number is refused.
    """

    value: float
    warn: float
    refuse: float
    text: str
    is_floor: bool = False

    def grade(self) -> str:
        """Return the verdict on this figure alone."""
        sign = -1.0 if self.is_floor else 1.0
        # written so that NaN is refused
        if not sign * self.value <= sign * self.refuse:
            return REFUSE
        return PASS if sign * self.value <= sign * self.warn else WARN

    def reason(self) -> str:
        """Return the sentence that says what is wrong, with the limit that was passed."""
        limit = self.warn if self.grade() == WARN else self.refuse
        word = "at least" if self.is_floor else "at most"
        return f"{self.text.format(self.value)} (wanted {word} {limit:.3g})"


class Verdict(NamedTuple):
    """A grade and why; no reason when all is well."""

    grade: str
    reasons: Sequence[str]

    @property
    def is_refused(self) -> bool:
        """Say whether nothing may be written."""
        return self.grade == REFUSE

    def plain(self) -> Dict[str, Any]:
        """Return ``verdict`` and ``reasons`` as plain values."""
        return {"verdict": self.grade, "reasons": list(self.reasons)}


def judge(limits: Sequence[Limit]) -> Verdict:
    """Return the worst grade of all figures, with a reason for each that does not pass."""
    reasons: List[str] = [limit.reason() for limit in limits if limit.grade() != PASS]
    return Verdict(worst([limit.grade() for limit in limits]), tuple(reasons))


def worst(grades: Sequence[str]) -> str:
    """Return the worst of several grades; ``pass`` when there is none."""
    return max(grades, key=_ORDER.index, default=PASS)


def known(values: Mapping[str, Any]) -> Dict[str, Any]:
    """Return plain values for JSON, with null for numbers that are not known (NaN)."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in values.items()
    }
