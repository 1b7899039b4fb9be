"""The same decomposition by NumPy and scikit-learn: python peers.py STACK (EXR files and an .lp list).
Prints seconds and the share of the energy of log light that 16 terms leave, as rows of the table."""
import os
import sys
import time

import numpy as np
import OpenEXR

folder = sys.argv[1]
names = [line.split()[0] for line in open(os.path.join(folder, "lights.lp")).read().split("\n")[1:] if line.strip()]


def read(name):
    with OpenEXR.File(os.path.join(folder, name), separate_channels=True) as f:
        c = f.channels()
        return np.stack([c[k].pixels.astype(np.float32) for k in "RGB"])


# White as translume has it: mean luminance of lit pixels over 0.18, cut at the brightest hundredth.
count = min(16, len(names))
luminance = [np.tensordot([0.2126, 0.7152, 0.0722], read(names[i * len(names) // count]).reshape(3, -1), 1) for i in range(count)]
lit = np.sort(np.concatenate([y[:: max(1, len(y) >> 14)] for y in luminance]))
lit = lit[lit > 0]
most = lit[len(lit) * 99 // 100]
white = np.minimum(lit[lit > 1e-3 * most], most).mean() / 0.18
start = time.time()
matrix = np.stack([np.log(0.01 + np.maximum(read(n), 0) / white).reshape(-1) for n in names])
print(f"| NumPy: read, logarithm | {time.time() - start:.2f} | |")
energy = float(np.einsum("ij,ij->", matrix, matrix, dtype=np.float64))


def row(name, make):
    start = time.time()
    u = make()
    secs = time.time() - start
    kept = float(((u.T @ matrix).astype(np.float64) ** 2).sum())
    print(f"| {name} | {secs:.2f} | {1 - kept / energy:.4e} |")


def gram():
    values, vectors = np.linalg.eigh((matrix @ matrix.T).astype(np.float64))
    u = vectors[:, ::-1][:, :16].astype(np.float32)
    u.T @ matrix  # the eigenimages
    return u


row("NumPy, Gram matrix and eigh", gram)
try:
    from sklearn.utils.extmath import randomized_svd

    row("scikit-learn, randomized_svd", lambda: randomized_svd(matrix, 16, random_state=0)[0])
except ImportError:
    print("| scikit-learn is not installed: skipped | | |")
