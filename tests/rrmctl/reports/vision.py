"""What colours look like to others: dichromats (Machado et al. 2009, severity 1) and a greyscale printer."""

import numpy as np

#: On linear RGB.
SIGHTS = {
    "usual": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_WHITE = _XYZ.sum(axis=1)


def linear(srgb):
    """Linear light of sRGB in [0, 1], [..., 3]."""
    srgb = np.asarray(srgb, dtype=float)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def seen(srgb, sight):
    """Linear light as it looks to this sight, [..., 3]."""
    return np.clip(linear(srgb) @ SIGHTS[sight].T, 0, 1)


def lab(light):
    """Linear light as CIE L*a*b*, [..., 3]."""
    ratio = light @ _XYZ.T / _WHITE
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def distance(one, two, sight):
    """CIE76 between two sRGB colours as this sight has them; about 2.3 can just be told apart side by side."""
    return float(np.linalg.norm(lab(seen(one, sight)) - lab(seen(two, sight))))


def lightness(srgb):
    """L* in 0 to 100: what a greyscale printer keeps."""
    return float(lab(linear(srgb))[..., 0])
