"""Which system libraries are missing, and the command that installs them.

Standard library only at import: `python -I recon/core/system_check.py` checks a machine before anything is
installed there.
"""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .errors import DependencyError

# shared library -> Debian/Ubuntu package
REQUIRED = {  # Open3D's wheel links against these
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libgomp.so.1": "libgomp1",
    "libusb-1.0.so.0": "libusb-1.0-0",
}
PICTURES = {"libvulkan.so.1": "libvulkan1"}  # of Open3D's renderer; without it the ray caster draws
VULKAN_DRIVERS = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")
VULKAN_DRIVER_PACKAGE = "mesa-vulkan-drivers"


def missing_packages() -> dict[str, str]:
    """Library -> package of what `import open3d` needs and this machine lacks."""
    return {library: package for library, package in REQUIRED.items() if not _loads(library)}


def missing_picture_packages() -> list[str]:
    """Packages that Open3D's renderer needs and this machine lacks. The product works without them."""
    packages = [package for library, package in PICTURES.items() if not _loads(library)]
    has_driver = any(any(Path(folder).glob("*.json")) for folder in VULKAN_DRIVERS)
    return packages if has_driver else [*packages, VULKAN_DRIVER_PACKAGE]


def install_command(packages: list[str]) -> str:
    """The line a person types."""
    return f"sudo apt-get install -y {' '.join(packages)}"


def dependency_error(error: ImportError | OSError) -> DependencyError | None:
    """What to tell a person about an import that failed; None if `error` is not about something to be installed."""
    from .errors import DependencyError

    if "cannot open shared object file" in str(error):
        missing = missing_packages()
        library = str(error).split(":")[0]
        command = install_command([*missing.values()]) if missing else f"apt-file search {library}"
        advice = f"install it with: {command}" if missing else f"find its package with: {command}"
        return DependencyError(f"the system library {', '.join(missing) or library} is missing; {advice}")
    if isinstance(error, ModuleNotFoundError) and error.name and error.name.split(".")[0] != "uncle":
        package = error.name.split(".")[0]
        return DependencyError(f"the Python package {package} is missing; install uncle again with: pip install -e .")
    return None


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def complaint() -> str | None:
    """What is missing and how to install it; None if the product can run."""
    missing = missing_packages()
    if not missing:
        return None
    command = install_command([*missing.values(), *missing_picture_packages()])
    return f"missing system libraries: {', '.join(missing)}\ninstall them with: {command}"


if __name__ == "__main__":
    sys.exit(complaint())
