"""Procedural textures: seamless (h, w, 3) uint8 sRGB images with detail at every scale."""

from __future__ import annotations

import colorsys

import cv2
import numpy as np
from numpy.typing import ArrayLike

SIZE = 512


def fractal(rng: np.random.Generator, slope: float = 1.2, stretch: float = 1.0, size: int = SIZE) -> np.ndarray:
    """(size, size) float32 seamless noise, mean 0, deviation 1, power spectrum 1/f^(2 slope).

    `stretch` > 1 draws it out along the rows (a grain).
    """
    fy = np.fft.fftfreq(size)[:, None] * size
    fx = np.fft.rfftfreq(size)[None] * size * stretch
    radius = np.sqrt(fx**2 + fy**2)
    radius[0, 0] = 1
    spectrum = rng.normal(size=radius.shape) + 1j * rng.normal(size=radius.shape)
    spectrum *= radius**-slope
    spectrum[0, 0] = 0
    noise = np.fft.irfft2(spectrum, s=(size, size))
    return (noise / noise.std()).astype(np.float32)


def hue(rng: np.random.Generator, saturation: float = 0.5, value: float = 0.6) -> np.ndarray:
    """(3,) a random colour, 0..255."""
    return np.array(colorsys.hsv_to_rgb(rng.uniform(), saturation, value)) * 255


def _image(base: ArrayLike, variation: np.ndarray, amount: float = 1.0) -> np.ndarray:
    """Base colour (3,) or (h, w, 3), lightened and darkened by `variation` (h, w) times `amount` levels."""
    return np.clip(np.asarray(base) + amount * variation[..., None], 0, 255).astype(np.uint8)


def plaster(rng: np.random.Generator, color: ArrayLike) -> np.ndarray:
    """A plain painted wall: what trackers and stereo matchers find little on."""
    return _image(color, fractal(rng, 1.0), 1.2)


def rough_plaster(rng: np.random.Generator, color: ArrayLike) -> np.ndarray:
    """Wiped plaster with clouds and grain."""
    return _image(color, fractal(rng, 1.4) + 0.6 * fractal(rng, 0.5), 11)


def wood(rng: np.random.Generator, color: ArrayLike) -> np.ndarray:
    """Wood, its grain along the rows."""
    grain, bend = fractal(rng, 1.0, 10), fractal(rng, 1.6, 4)
    rows = np.arange(SIZE)[:, None] / SIZE
    rings = np.sin(2 * np.pi * (7 * rows) + 2.2 * bend)
    pores = np.maximum(fractal(rng, 0.3, 14) - 1.2, 0)
    return _image(color, 14 * rings + 10 * grain - 14 * pores)


def planks(rng: np.random.Generator, color: ArrayLike, rows: int = 8) -> np.ndarray:
    """A plank floor: rows of boards with their own grain, tone and joints."""
    board = SIZE // rows
    grain = wood(rng, color).astype(np.float32)
    out = np.empty_like(grain)
    for row in range(rows):
        strip = slice(row * board, (row + 1) * board)
        piece = np.roll(grain, (int(rng.integers(SIZE)), int(rng.integers(SIZE))), axis=(0, 1))[strip]
        joint = int(rng.integers(SIZE))
        tone = np.where((np.arange(SIZE) - joint) % SIZE < SIZE // 2, rng.normal(0, 14), rng.normal(0, 14))
        piece = piece + tone[None, :, None]
        piece[:2] -= 55
        piece[:, [joint, (joint + 1) % SIZE, (joint + SIZE // 2) % SIZE]] -= 55
        out[strip] = piece
    return np.clip(out, 0, 255).astype(np.uint8)


def tiles(rng: np.random.Generator, color: ArrayLike, other: ArrayLike, count: int = 4) -> np.ndarray:
    """A chequered tile floor with grout."""
    cell = SIZE // count
    index = np.arange(SIZE) // cell
    pattern = (index[:, None] + index[None]) % 2
    tone = rng.normal(0, 7, (count, count))[index[:, None], index[None]]
    base = np.where(pattern[..., None] == 0, np.asarray(color), np.asarray(other))
    image = base + (tone + 9 * fractal(rng, 1.1))[..., None]
    grout = np.arange(SIZE) % cell < 4
    image[grout] = image[:, grout] = 120
    return np.clip(image + 4 * fractal(rng, 0.3)[..., None], 0, 255).astype(np.uint8)


def bricks(rng: np.random.Generator, color: ArrayLike) -> np.ndarray:
    """A brick wall."""
    height, width = SIZE // 8, SIZE // 4
    y, x = np.mgrid[:SIZE, :SIZE]
    row = y // height
    shifted = (x + (row % 2) * width // 2) % SIZE
    tone = rng.normal(0, 16, (8, 4))[row, shifted // width]
    image = np.asarray(color) + (tone + 12 * fractal(rng, 0.9))[..., None]
    mortar = (y % height < 6) | (shifted % width < 6)
    image[mortar] = 175 + 9 * fractal(rng, 0.5)[mortar][:, None]
    return np.clip(image, 0, 255).astype(np.uint8)


def wallpaper(rng: np.random.Generator, color: ArrayLike, other: ArrayLike, stripes: int = 8) -> np.ndarray:
    """Stripes with a printed ornament."""
    x = np.arange(SIZE) * stripes * 2 * np.pi / SIZE
    y = np.arange(SIZE) * 6 * 2 * np.pi / SIZE
    band = (np.sin(x) > 0.1)[None, :, None]
    ornament = np.sin(2 * x)[None] * np.sin(y)[:, None] + 0.35 * fractal(rng, 1.3)
    image = np.where(band, np.asarray(color), np.asarray(other)) + 22 * (ornament > 0.45)[..., None]
    return np.clip(image + 4 * fractal(rng, 0.8)[..., None], 0, 255).astype(np.uint8)


def fabric(rng: np.random.Generator, color: ArrayLike) -> np.ndarray:
    """Woven cloth: threads and worn places."""
    thread = np.arange(SIZE) * 64 * 2 * np.pi / SIZE
    weave = np.sin(thread)[None] * np.sin(thread)[:, None]
    return _image(color, 9 * weave + 9 * fractal(rng, 1.3) + 7 * fractal(rng, 0.2))


def carpet(rng: np.random.Generator, color: ArrayLike, other: ArrayLike) -> np.ndarray:
    """A rug, to be stretched: border, diamonds and tufts."""
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE * 2 - 1
    edge = np.maximum(np.abs(x), np.abs(y))
    diamonds = (np.floor((x + y) * 4) + np.floor((x - y) * 4)) % 2
    image = np.where(diamonds[..., None] == 0, np.asarray(color), np.asarray(other))
    image[(edge > 0.8) & (edge < 0.92)] = hue(rng, 0.5, 0.75)
    medallion = (x**2 + y**2 < 0.12) & (np.sin(9 * np.arctan2(y, x)) + 6 * np.hypot(x, y) < 1.6)
    image[medallion] = hue(rng, 0.6, 0.8)
    return _image(image, 9 * fractal(rng, 0.2) + 8 * fractal(rng, 1.2))


def marble(rng: np.random.Generator, color: ArrayLike) -> np.ndarray:
    """Polished stone with veins."""
    veins = np.exp(-8 * np.abs(fractal(rng, 1.5)))
    return _image(color, 10 * fractal(rng, 1.2) - 70 * veins + 4 * fractal(rng, 0.4))


def leaves(rng: np.random.Generator) -> np.ndarray:
    """Foliage."""
    light = fractal(rng, 0.7)
    image = np.array([58.0, 105.0, 45.0]) + light[..., None] * np.array([26.0, 36.0, 18.0])
    image[fractal(rng, 0.8) > 1.1] *= 0.4
    return np.clip(image, 0, 255).astype(np.uint8)


def book_spines(rng: np.random.Generator) -> np.ndarray:
    """Coloured columns with bands and specks of lettering, about 20 across."""
    image = np.zeros((SIZE, SIZE, 3), np.float32)
    x = 0
    while x < SIZE:
        width = int(rng.integers(18, 40))
        column = image[:, x : x + width]
        column[:] = hue(rng, rng.uniform(0.2, 0.8), rng.uniform(0.3, 0.9))
        for top in rng.integers(0, SIZE - 20, 3):
            column[top : top + int(rng.integers(4, 20))] = hue(rng, 0.4, 0.95)
        letters = rng.uniform(size=(SIZE // 4, max(1, column.shape[1] // 4))) > 0.72
        stamped = cv2.resize(letters.astype(np.float32), column.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        stamped[: SIZE // 4] = stamped[-SIZE // 4 :] = 0
        column += 60 * stamped[..., None]
        column[:, :2] *= 0.35
        x += width
    return _image(image, 5 * fractal(rng, 0.6))


def painting(rng: np.random.Generator, size: int = 256) -> np.ndarray:
    """A framed picture: a landscape with a sun, or coloured fields."""
    y, x = np.mgrid[:size, :size] / size
    image = hue(rng, 0.35, 0.9) * (1 - y[..., None]) + hue(rng, 0.35, 0.8) * y[..., None]
    if rng.uniform() < 0.5:
        sun = rng.uniform(0.2, 0.8, 2) * [1, 0.4]
        image[np.hypot(x - sun[0], y - sun[1]) < 0.08] = [250, 220, 140]
        for layer in range(4):
            ridge = 0.4 + 0.14 * layer + 0.06 * fractal(rng, 1.4, size=size)[0]
            image[y > ridge[None]] = hue(rng, 0.5, 0.75 - 0.15 * layer)
    else:
        for _ in range(14):
            x0, y0 = rng.uniform(0, 0.8, 2)
            w, h = rng.uniform(0.08, 0.4, 2)
            image[(x > x0) & (x < x0 + w) & (y > y0) & (y < y0 + h)] = hue(rng, 0.7, 0.85)
    image = image + 10 * fractal(rng, 0.9, size=size)[..., None]
    frame = np.minimum.reduce([x, y, 1 - x, 1 - y])
    image[frame < 0.06] = hue(rng, 0.4, 0.35)
    image[(frame >= 0.06) & (frame < 0.1)] = 235
    return np.clip(image, 0, 255).astype(np.uint8)
