"""Statistics of a device for a report: messages, force, clutch, and the time without force by its reason."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

# reasons of a hand without force
NO_CONTACT = "no contact"
CLUTCH_PRESSED = "clutch"
NO_READING = "waiting for the first reading"
OLD_READING = "readings of the engine too old"
NOT_RUNNING = "engine paused, or no tool"
NO_ANSWER = "no answer of the service"
NOT_LISTED = "not listed by the service"
POSITION_JUMP = "jump of the position"
SUMMED_FIELDS = ("seconds", "messages", "impulse", "clutches", "interruptions", "ramped", "limited", "damped")


def tool_name(index: int) -> str:
    """Return the name of a tool for people: they count from 1."""
    return f"tool {index + 1}"


@dataclass
class HandStatistics:
    """What happened at a device; times [s] are those in which the force was held."""

    tool: int  # index
    seconds: float = 0.0
    messages: int = 0
    peak_force: float = 0.0  # [N]
    impulse: float = 0.0  # [N s]: integral of the size of the force
    clutches: int = 0
    interruptions: int = 0  # of the force in contact, other than by a clutch: a ramp follows each
    ramped: float = 0.0  # [s] with force, of which a ramp took a part
    limited: float = 0.0  # [s] at the limit
    damped: float = 0.0  # [s] with force that the passivity observer changed
    without_force: dict[str, float] = field(default_factory=dict)  # [s] by reason

    def add(self, other: HandStatistics) -> None:
        """Add what happened at the same device at other times."""
        self.tool, self.peak_force = other.tool, max(self.peak_force, other.peak_force)
        for name in SUMMED_FIELDS:
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for reason, seconds in other.without_force.items():
            self.without_force[reason] = self.without_force.get(reason, 0.0) + seconds


def add_statistics(total: dict[str, HandStatistics], update: Mapping[str, Mapping[str, Any]]) -> None:
    """Add statistics by device, as an adapter sends them."""
    for name, values in update.items():
        other = HandStatistics(**values)
        total.setdefault(name, HandStatistics(other.tool)).add(other)


def hand_report(name: str, hand: HandStatistics) -> dict[str, Any]:
    """Return the report of a device; the mean force is that of the time with force."""
    without = dict(sorted(hand.without_force.items(), key=lambda each: -each[1]))
    with_force = max(hand.seconds - sum(without.values()), 0.0)
    values = asdict(hand)
    for each in ("impulse", "without_force", "tool"):
        del values[each]
    return values | {
        "device": name,
        "rate": hand.messages / hand.seconds if hand.seconds else None,
        "with_force": with_force,
        "mean_force": hand.impulse / with_force if with_force else None,
        "clutch_seconds": without.get(CLUTCH_PRESSED, 0.0),
        "without_force": without,
    }


def hand_reports(total: Mapping[str, HandStatistics]) -> dict[str, dict[str, Any]]:
    """Return the reports of all devices, by the name of their tool; of two on one tool the device is named, too."""
    tools = [hand.tool for hand in total.values()]
    return {
        tool_name(hand.tool) + (f" ({name})" if tools.count(hand.tool) > 1 else ""): hand_report(name, hand)
        for name, hand in sorted(total.items(), key=lambda each: each[1].tool)
    }


def longest(times: Mapping[str, float]) -> Iterable[str]:
    """Return reasons with their times, the longest first."""
    return [f"{reason} {seconds:.3g} s" for reason, seconds in times.items()]
