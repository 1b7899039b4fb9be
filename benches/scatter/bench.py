"""translume scatter fit beside SciPy's least_squares on samples with a known model. Called by run.sh, from the root."""
import argparse, csv, json, os, platform, subprocess, tempfile, time
import numpy as np
from scipy.optimize import least_squares

BINARY = os.path.join(os.environ.get("CARGO_TARGET_DIR", "target"), "release", "translume")
STARTS = 6  # random ones for SciPy, the best is kept
np.seterr(all="ignore")


def medium(kind, points, samples, rng):
    """(points, samples, 3): x, y in mm and R_d of three exponentials with 5 % noise, or of what `kind` says."""
    r = 0.15 * (8 / 0.15) ** rng.uniform(size=(points, samples))
    phi = rng.uniform(-np.pi, np.pi, (points, samples))
    c = np.exp(rng.normal([0.5, -1.5, -4], 0.3, (points, 3)))[:, None]
    d = -np.exp(rng.normal([1.2, 0.1, -0.9], 0.15, (points, 3)))[:, None]
    s = r
    if kind == "direction-dependent":
        s = r * (1 + 0.35 * np.cos(phi - rng.uniform(-np.pi, np.pi, (points, 1))))
    value = (c * np.exp(d * s[..., None])).sum(-1)
    if kind == "shoulder":
        value -= 0.9 * np.exp(-4.5 * r) * value
    value *= np.exp(rng.normal(0, 0.05, value.shape))
    return np.stack([r * np.cos(phi), r * np.sin(phi), value], -1).astype(np.float32)


def error(model, v):
    return float(np.sqrt(np.mean((np.log(np.maximum(model, 1e-30)) - np.log(v)) ** 2)))


def scipy_fit(r, v, rng):
    """RMS error of the logarithm of the best of STARTS fits, in log amplitudes and log rates, and the seconds it took."""
    def residual(x):
        return np.log(np.maximum((np.exp(x[:3, None]) * np.exp(-np.exp(x[3:, None]) * r)).sum(0), 1e-30)) - np.log(v)
    start = time.perf_counter()
    costs = []
    for _ in range(STARTS):
        x0 = np.concatenate([np.log(v.max()) + rng.normal([0, -2, -4], 0.7), rng.normal([1, 0, -1], 0.4)])
        costs.append(least_squares(residual, x0, method="lm", max_nfev=400).cost)
    return float(np.sqrt(2 * min(costs) / len(r))), time.perf_counter() - start


def ours(folder, name, data, segments):
    """The fits, and the seconds of the whole run, files included."""
    source, result = os.path.join(folder, name + ".npy"), os.path.join(folder, name + ".json")
    np.save(source, data)
    command = [BINARY, "scatter", "fit", source, "--terms", "3", "--segments", str(segments), "-o", result, "--quiet"]
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return json.load(open(result))["points"], time.perf_counter() - start


def value(point, x, y):
    """The model of one point [Fuchs 2005, Eq. 3]."""
    r, phi = np.hypot(x, y), np.arctan2(y, x)
    segments = [sum(c * np.exp(d * r) for c, d in zip(s["c"], s["d"])) for s in point["segments"]]
    at = np.mod(phi, 2 * np.pi) / (2 * np.pi) * len(segments)
    low = np.floor(at).astype(int)
    w, n, i = at - low, len(segments), np.arange(len(r))
    segments = np.stack(segments)
    return (1 - w) * segments[low % n, i] + w * segments[(low + 1) % n, i]


def main():
    args = argparse.ArgumentParser(description=__doc__)
    args.add_argument("--points", type=int, default=2000)
    args = args.parse_args()
    rng, rows = np.random.default_rng(1), []
    with tempfile.TemporaryDirectory() as folder:
        for kind in ["isotropic", "shoulder", "direction-dependent"]:
            data = medium(kind, args.points, 2000, rng)
            theirs, seconds = zip(*(scipy_fit(np.hypot(*p[:, :2].T).astype(float), p[:, 2].astype(float), rng)
                                    for p in data[:20]))
            rate = 20 * STARTS / sum(seconds)
            rows.append((kind, "SciPy, best of 6", np.mean(theirs), rate, 1.0))
            for segments in [1, 4, 8]:
                few = data if segments == 1 else data[: args.points // 10]
                # The second run holds the data several times: the difference is without the start of the program.
                fits, once = ours(folder, "a", few, segments)
                _, more = ours(folder, "b", np.tile(few, (4, 1, 1)), segments)
                mean = np.mean([error(value(f, *p[:, :2].T.astype(float)), p[:, 2]) for f, p in zip(fits[:20], data)])
                own = 3 * len(few) / (more - once)
                rows.append((kind, f"translume, {segments} segments" if segments > 1 else "translume", mean, own, own / rate))
    report(args, rows)


def report(args, rows):
    cpu = next((l.split(":")[1].strip() for l in open("/proc/cpuinfo") if l.startswith("model name")), platform.machine())
    machine = f"{cpu}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    with open("benches/results/scatter-fit.csv", "w", newline="") as f:
        f.write(f"# {machine}\n")
        w = csv.writer(f)
        w.writerow(["medium", "fit", "rms_ln", "fits_per_s", "speed_over_scipy"])
        w.writerows((k, n, f"{e:.5f}", f"{r:.1f}", f"{s:.1f}") for k, n, e, r, s in rows)
    lines = ["# Sums of three exponentials: translume beside SciPy", "",
             f"Machine: {machine}. {args.points} points of 2,000 samples with 5 % noise; the error is the RMS of ln(model/sample),",
             "mean over 20 points. A fit is one point (all its segments); for SciPy it is one start of `least_squares` (LM) on one core,",
             "of which the best of six is kept; translume's time includes its files. Made by `benches/scatter/run.sh`.", "",
             "| medium | fit | error | fits/s | over SciPy |", "|---|---|---|---|---|"]
    lines += [f"| {k} | {n} | {e:.4f} | {r:.0f} | {s:.1f} |" for k, n, e, r, s in rows]
    text = "\n".join(lines) + "\n"
    open("benches/results/scatter-fit.md", "w").write(text)
    print(text)


if __name__ == "__main__":
    main()
