"""Samples per second of `translume render --integrator path` and of Mitsuba's `path`. Called by run.sh, from the root.

Both render the same file at the same size on one thread, each run in a process of its own, the renderers in turn. What
counts is the processor time of the samples beyond the first few, so that loading, compiling and other programs on the
machine do not.
"""
import argparse, csv, json, math, os, platform, re, statistics, subprocess, sys, tempfile, time

BINARY = os.path.join(os.environ.get("CARGO_TARGET_DIR", "target"), "release", "translume")
SCENES = {"cornell-box": "cornell-box/mitsuba/scene_v3.xml", "modern-hall": "modern-hall/scene.xml", "living-room": "living-room/scene.xml",
          "matpreview": "matpreview/matpreview.xml", "sponza": "sponza-dabrovic/sponza.xml"}
LONGER_SIDE = 256
# Samples per pixel before the clock runs, and of a whole run: powers of four, to which Mitsuba's samplers round the number up unseen.
FEW, MOST = 4, 16


def for_mitsuba_3(path, size):
    """The file's text without what Mitsuba 3 refuses, at this size."""
    text = open(path).read().replace("<lookAt ", "<lookat ")
    text = re.sub(r'<boolean name="(high_quality_edges|highQualityEdges)"[^>]*/>', "", text)
    text = re.sub(r'<float name="max_?[sS]mooth_?[aA]ngle"[^>]*/>', "", text)
    for name, value in zip(("width", "height"), size):
        text = re.sub(rf'(<integer name="{name}" value=")[^"]*"', rf'\g<1>{value}"', text)
    return text


def size_of(path):
    info = json.loads(subprocess.run([BINARY, "scene", "info", path, "--json"], capture_output=True, check=True).stdout)
    w, h = (info["sensors"][0][k] for k in ("width", "height"))
    scale = LONGER_SIDE / max(w, h)
    return round(w * scale), round(h * scale)


def measured(command):
    """Processor seconds, peak MiB and output of a process; None if it failed."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    out = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    return None if status else (usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, out)


def ours(path, size, spp):
    def run(n):
        with tempfile.TemporaryDirectory() as folder:
            return measured([BINARY, "render", path, "-o", os.path.join(folder, "o.exr"), "--integrator", "path", "--spp", str(n), "--size",
                             f"{size[0]}x{size[1]}", "--threads", "1", "--quiet"])
    few, many = run(FEW), run(FEW + spp)
    return size[0] * size[1] * spp / (many[0] - few[0]), many[1]


def mitsuba(variant, path, size, spp):
    run = measured([sys.executable, __file__, "--mitsuba", variant, path, str(size[0]), str(size[1]), str(spp)])
    return run and (size[0] * size[1] * spp / float(run[2].split()[-1]), run[1])


def mitsuba_process(variant, path, width, height, spp):
    import drjit, mitsuba
    mitsuba.set_variant(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    mitsuba.file_resolver().append(os.path.dirname(path))
    scene = mitsuba.load_string(for_mitsuba_3(path, (width, height)))
    drjit.set_thread_count(1)  # not before: loading in parallel waits for itself then
    seconds = []
    for n in (FEW, int(spp) + FEW) if variant.startswith("scalar") else (int(spp) + FEW, FEW, int(spp) + FEW):
        begun = time.process_time()
        drjit.eval(mitsuba.render(scene, spp=n, seed=n))
        drjit.sync_thread()
        seconds.append(time.process_time() - begun)
    print(seconds[-1] - seconds[-2])


def main():
    if sys.argv[1:2] == ["--mitsuba"]:
        return mitsuba_process(*sys.argv[2:])
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--scenes", default=",".join(SCENES))
    arguments.add_argument("--spp", type=int, default=MOST, help="a power of four")
    arguments.add_argument("--rounds", type=int, default=3)
    arguments = arguments.parse_args()
    if arguments.spp <= FEW or 4 ** round(math.log(arguments.spp, 4)) != arguments.spp:
        sys.exit(f"--spp {arguments.spp}: a power of four above {FEW} is wanted")
    arguments.spp -= FEW
    rows, variants = [], ["scalar_rgb", "llvm_ad_rgb"]
    for name in arguments.scenes.split(","):
        path = os.path.join(os.environ["TRANSLUME_DATA"], "scenes", SCENES[name])
        size = size_of(path)
        runs = {"ours": [], **{v: [] for v in variants}}
        for _ in range(arguments.rounds):
            runs["ours"].append(ours(path, size, arguments.spp))
            for variant in list(variants):
                run = mitsuba(variant, path, size, arguments.spp)
                if run is None:
                    print(f"{variant} does not run here and is left out", file=sys.stderr)
                    variants.remove(variant)
                else:
                    runs[variant].append(run)
        rate = {v: statistics.median(r[0] for r in runs[v]) / 1e3 for v in ["ours", *variants]}
        memory = {v: statistics.median(r[1] for r in runs[v]) for v in ["ours", *variants]}
        rows.append([name, f"{size[0]} × {size[1]}", rate, memory])
        print(rows[-1], flush=True)
    write(rows, variants, arguments)


def write(rows, variants, arguments):
    import mitsuba
    columns = ["scene", "pixels", "translume, thousand samples/s", *variants, *(f"translume / {v}" for v in variants), "translume, peak MiB",
               *(f"{v}, MiB" for v in variants)]
    both = ["ours", *variants]
    cells = [[name, size, *(f"{rate[v]:.0f}" for v in both), *(f"{rate['ours'] / rate[v]:.2f}" for v in variants), *(f"{memory[v]:.0f}" for v in both)]
             for name, size, rate, memory in rows]
    with open("benches/results/render-speed.csv", "w", newline="") as file:
        csv.writer(file).writerows([columns, *cells])
    machine = next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), platform.machine())
    table = "\n".join("| " + " | ".join(row) + " |" for row in [columns, ["---"] * len(columns), *cells])
    means = [f"{statistics.geometric_mean(r[2]['ours'] / r[2][v] for r in rows):.2f} times {v}" for v in variants]
    text = f"""# Speed and memory of `path` beside Mitsuba {mitsuba.__version__}

Machine: {machine}, one thread each. Medians of {arguments.rounds} rounds of {arguments.spp} samples per pixel, the renderers in turn, in samples per
second of processor time. The machine was shared: ratios say more than absolute figures. Made by `benches/render/run.sh`.

{table}

Geometric mean: {', '.join(means)}.{'' if 'llvm_ad_rgb' in variants else ' Mitsuba’s llvm_ad_rgb does not run on this machine.'}
"""
    open("benches/results/render-speed.md", "w").write(text)
    print(text)


if __name__ == "__main__":
    main()
