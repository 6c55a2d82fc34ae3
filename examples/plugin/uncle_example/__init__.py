"""What the package adds. Loaded whenever methods or readers are listed: it imports neither PyTorch nor its modules."""

from pydantic import Field
from uncle.datasets import ReaderSpec
from uncle.recon.core.config.base import Strict
from uncle.recon.methods import MethodSpec


class InversePowerConfig(Strict):
    """Settings of the method: `uncle map --set plugin.power=1`."""

    power: float = Field(2.0, ge=0, le=4, description="The weight of a measurement at depth z is 1 / z^power.")


METHOD_SPEC = MethodSpec(
    name="inverse-power",
    summary="fusion with weights that fall with the depth, an example of a plugin",
    kind="batch",
    implementation="uncle_example.method:fuse",
    preset={"fusion": {"passes": 0}, "uncertainty": {"enabled": False}, "field": {"iterations": 0, "levels": []}},
    settings=InversePowerConfig,
    is_deterministic=True,
)

READER_SPEC = ReaderSpec(
    name="npz",
    layout="camera.json and frame_*.npz",
    summary="a NumPy file for each frame, an example of a plugin",
    reader="uncle_example.reader",
)
