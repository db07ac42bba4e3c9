"""How the parameters of a law are declared: a frozen dataclass beside the law, values in a profile.

Field names carry the paper's symbol and the unit (`M_A_kg`, `k_H_N_per_m`, `timeout_s`); limits stand in the type
(`Annotated[float, Gt(0)]`), where the configuration enforces them. Nothing here imports pydantic, so laws stay pure.
"""

from dataclasses import dataclass
from typing import Annotated, TypeVar, dataclass_transform

from annotated_types import Ge, Gt, Le

T = TypeVar("T")

Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Fraction = Annotated[float, Ge(0), Le(1)]


@dataclass_transform(frozen_default=True, kw_only_default=True)
def parameters(cls: type[T]) -> type[T]:
    """Make `cls` a frozen, keyword-only dataclass that refuses unknown keys when read from a profile."""
    cls.__pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # type: ignore[attr-defined]
    return dataclass(frozen=True, kw_only=True)(cls)
