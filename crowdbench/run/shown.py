"""What a policy sees: the one place that decides which observation a simulation shows to it."""

from dataclasses import replace
from typing import Any

from crowdbench.errors import SettingError
from crowdbench.policies import Policy
from crowdbench.simulation import Settings, Shown
from crowdbench.simulation.observations import version_of


def needs(policy: Policy) -> dict[str, Any]:
    """What a policy needs to see: those of the fields of `Shown` that it has as attributes.

    A policy with the attribute `observation` but none for its rays needs the default rays. Empty
    for a policy that sees the state, and for one that takes any observation.

    Raises:
        SettingError: there is no such observation.
    """
    if policy.sees == "state":
        return {}
    named = {name: getattr(policy, name, None) for name in Shown._fields}
    found = {name: value for name, value in named.items() if value is not None}
    if "observation" not in found:
        return found
    if not version_of(found["observation"]).rays:
        return {"observation": found["observation"]}
    return Shown()._asdict() | found


def settings_for(
    policy: Policy, settings: Settings | None = None, *, hint: str | None = None
) -> Settings:
    """Settings of a simulation whose observation is the one that a policy needs.

    What the policy does not say is that of `settings`, whose `max_alive` is 4096 if it is None.
    `hint` replaces the hint of the error, and may contain `{name}` and `{value!r}`.

    Raises:
        SettingError: `settings` contain a value that contradicts the policy, or there is no such
            observation.
    """
    settings = Settings(max_alive=4096) if settings is None else settings
    if policy.sees == "state":
        return settings
    needed = needs(policy)
    filled = replace(settings, **settings.shown._replace(**needed)._asdict())
    for name, value in needed.items():
        chosen = getattr(settings, name)
        applies = name == "observation" or filled.shown.version.rays
        if chosen is not None and chosen != value and applies:
            hint = hint or "Set {name}={value!r}, or leave it out of the settings."
            raise SettingError(
                f"policy {policy.name}",
                got=f"{name} = {chosen!r} in the settings",
                expected=f"{name} = {value!r}, which the policy needs",
                hint=hint.format(name=name, value=value),
            )
    return filled


def check_shown(policy: Policy, settings: Settings) -> None:
    """Check that a simulation with these settings shows what a policy needs.

    Raises:
        SettingError: it shows something else.
    """
    settings_for(policy, replace(settings, **settings.shown._asdict()))
