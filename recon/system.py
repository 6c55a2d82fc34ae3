"""Which system libraries are missing, and the command that installs them.

Standard library only at import: `python -I recon/system.py` checks a machine before anything is installed there.
"""

from __future__ import annotations

import ctypes
import importlib
import sys
from pathlib import Path
from types import ModuleType

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


def import_open3d() -> ModuleType:
    """The module `open3d`. Raises DependencyError naming the packages to install where it cannot be loaded."""
    from .errors import DependencyError

    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as error:
        missing = missing_packages()
        if missing:
            what = f"Open3D needs the system libraries {', '.join(missing)}"
            raise DependencyError(f"{what}; install them with: {install_command([*missing.values()])}") from error
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DependencyError(f"Open3D cannot be loaded ({reason}); install it with: pip install open3d") from error


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
