"""Writes small files in the layout of RGL's `.bsdf` and, with Mitsuba 3, what its `measured` plugin says of them.

    python make.py            # *.bsdf
    python make.py mitsuba    # and mitsuba.txt

The material is a metal of anisotropic GGX microfacets with made-up colours; it is not a measurement. A file holds what Dupuy and
Jakob's parameterisation ("An Adaptive Parameterization for Efficient Material Acquisition and Rendering", 2018) asks for.
"""

import struct
import sys

import numpy as np

DTYPES = {np.dtype("u1"): 1, np.dtype("f4"): 10}


def write(path, fields):
    head = b"tensor_file\0" + bytes([1, 0]) + struct.pack("<I", len(fields))
    size = len(head) + sum(2 + len(k) + 2 + 1 + 8 + 8 * v.ndim for k, v in fields.items())
    body = b""
    for name, values in fields.items():
        head += struct.pack("<H", len(name)) + name.encode() + struct.pack("<HBQ", values.ndim, DTYPES[values.dtype], size + len(body))
        head += struct.pack(f"<{values.ndim}Q", *values.shape)
        body += values.tobytes()
    with open(path, "wb") as f:
        f.write(head + body)


def ggx(m, au, av):
    """Density of microfacet normals."""
    return 1 / (np.pi * au * av * ((m[0] / au) ** 2 + (m[1] / av) ** 2 + m[2] ** 2) ** 2)


def lam(w, au, av):
    return (np.sqrt(1 + ((w[0] * au) ** 2 + (w[1] * av) ** 2) / np.maximum(w[2], 1e-6) ** 2) - 1) / 2


def direction(u, v):
    """Of the unit square's point."""
    theta, phi = u**2 * np.pi / 2, (2 * v - 1) * np.pi
    return np.stack([np.cos(phi) * np.sin(theta), np.sin(phi) * np.sin(theta), np.cos(theta)])


def square(w):
    return np.sqrt(np.arccos(np.clip(w[2], -1, 1)) * 2 / np.pi), (np.arctan2(w[1], w[0]) + np.pi) / (2 * np.pi)


def grid(n, m):
    """u along the last axis."""
    v, u = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, m), indexing="ij")
    return u, v


def warp(density, s):
    """Points at which the cumulative distributions of the bilinear density, rows first, have the values `s`: [2, ny, nx]."""
    n, m = density.shape
    fine = 64  # nodes in a cell, as an independent way to the same points as the closed form
    rows = np.interp(np.arange((n - 1) * fine + 1) / fine, np.arange(n), (density[:, 1:] + density[:, :-1]).sum(1))
    marginal = np.concatenate([[0], np.cumsum((rows[1:] + rows[:-1]) / 2)])
    y = np.interp(s[1] * marginal[-1], marginal, np.linspace(0, 1, len(marginal)))
    x = np.empty_like(y)
    for i in np.ndindex(y.shape):
        j = min(int(y[i] * (n - 1)), n - 2)
        t = y[i] * (n - 1) - j
        row = np.interp(np.arange((m - 1) * fine + 1) / fine, np.arange(m), density[j] * (1 - t) + density[j + 1] * t)
        total = np.concatenate([[0], np.cumsum((row[1:] + row[:-1]) / 2)])
        x[i] = np.interp(s[0][i] * total[-1], total, np.linspace(0, 1, len(total)))
    return x, y


def material(theta_i, phi_i, n, samples, au, av, colours):
    """All fields; `colours` are factors as functions of a cosine, one for each channel."""
    isotropic = len(phi_i) <= 2
    u, v = grid(n if not isotropic else 2, n)
    m = direction(u, v)
    fields = {"ndf": ggx(m, au, av)}
    fields["sigma"] = np.maximum(m[2], 0) * (1 + lam(m, au, av))
    vndf, values = [], []
    u, v = grid(n, n)
    s = np.stack(np.meshgrid(np.linspace(0, 1, samples), np.linspace(0, 1, samples), indexing="xy"))
    for phi in phi_i:
        for theta in theta_i:
            wi = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
            m = direction(u, v + (phi / (2 * np.pi) if isotropic else 0))
            cos_sigma = np.cos(theta) * (1 + lam(wi, au, av))
            d = ggx(m, au, av) * np.maximum(np.tensordot(wi, m, 1), 0) / cos_sigma
            d = np.maximum(d * 2 * np.pi**2 * u * np.sin(u**2 * np.pi / 2), 1e-6)
            vndf.append(d)
            um, vm = warp(d, s)
            m = direction(um, vm + (phi / (2 * np.pi) if isotropic else 0))
            cos_d = np.tensordot(wi, m, 1)
            wo = 2 * cos_d * m - wi[:, None, None]
            seen = np.where(wo[2] > 0, 1 / (1 + lam(wo, au, av)), 0)
            values.append([seen * c(np.clip(cos_d, 0, 1)) for c in colours])
    shape = (len(phi_i), len(theta_i))
    fields["vndf"] = np.array(vndf).reshape(*shape, n, n)
    values = np.array(values).reshape(*shape, len(colours), samples, samples)
    fields["luminance"] = np.maximum(values.mean(2), 1e-4)
    fields["rgb" if len(colours) == 3 else "spectra"] = values
    fields |= {"theta_i": np.array(theta_i), "phi_i": np.array(phi_i)}
    fields = {k: np.ascontiguousarray(v, np.float32) for k, v in fields.items()}
    text = np.frombuffer(b"made up", np.uint8)
    return {"description": text, "jacobian": np.array([1], np.uint8)} | fields


def schlick(f0):
    return lambda c: f0 + (1 - f0) * (1 - c) ** 5


RGB = [schlick(f) for f in (0.9, 0.6, 0.3)]
NM = np.array([400, 500, 600, 700], np.float32)


def write_all():
    theta = np.linspace(0, 1, 5) ** 1.5 * np.pi / 2
    write("isotropic.bsdf", material(theta, [0.0], 12, 8, 0.3, 0.3, RGB))
    write("anisotropic.bsdf", material(theta[:4], np.linspace(-np.pi, 0, 5), 10, 6, 0.2, 0.5, RGB))
    half = material(theta[:3], np.linspace(-np.pi, np.pi, 5), 8, 5, 0.2, 0.5, RGB)
    write("whole-turn.bsdf", half | {"jacobian": np.array([0], np.uint8)})
    spectral = material(theta[:3], [0.0], 8, 5, 0.3, 0.3, [schlick(f) for f in (0.2, 0.3, 0.7, 0.9)])
    write("spectral.bsdf", spectral | {"wavelengths": NM})


def mitsuba_table():
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    rng = np.random.default_rng(7)
    with open("mitsuba.txt", "w") as out:
        out.write("# Mitsuba %s, scalar_rgb: file, wi, wo, eval (times cosine), pdf, then wo sampled from u, weight, pdf\n" % mi.__version__)
        for name in ("isotropic", "anisotropic", "whole-turn"):
            bsdf = mi.load_dict({"type": "measured", "filename": f"{name}.bsdf"})
            for _ in range(40):
                u = rng.random(6)
                wi, wo = (mi.warp.square_to_uniform_hemisphere(mi.Point2f(*p)) for p in (u[:2], u[2:4]))
                si = mi.SurfaceInteraction3f()
                si.wi = wi
                ctx = mi.BSDFContext()
                f, p = bsdf.eval(ctx, si, wo), bsdf.pdf(ctx, si, wo)
                drawn, weight = bsdf.sample(ctx, si, float(u[0]), mi.Point2f(*u[4:]))
                row = [*wi, *wo, *f, p, *u[4:], *drawn.wo, *weight, drawn.pdf]
                out.write(name + " " + " ".join(f"{x:.7g}" for x in np.array(row, float)) + "\n")


write_all()
if sys.argv[1:] == ["mitsuba"]:
    mitsuba_table()
