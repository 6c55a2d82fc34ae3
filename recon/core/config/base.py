"""The base of every group of settings."""

from pydantic import BaseModel, ConfigDict


class Strict(BaseModel):
    """Frozen, without unknown keys and without infinities."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
