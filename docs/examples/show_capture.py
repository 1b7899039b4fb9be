"""Opens a capture set with plain JSON and Zarr tools and plots one frame. Needs zarr (3), numpy; matplotlib to plot.
   python docs/examples/show_capture.py CAPTURE [frame.png]"""
import json, os, sys
import numpy as np
import zarr


def main():
    folder = sys.argv[1]
    rig = json.load(open(os.path.join(folder, "rig.json")))
    frames = zarr.open_array(os.path.join(folder, rig["frames"]), mode="r")
    view, position, channel = 0, frames.shape[1] // 2, min(1, frames.shape[2] - 1)
    frame = frames[view, position, channel]
    assert frames.shape[:3] == (len(rig["views"]), len(rig["laser"]["hits_mm"]), len(rig["channels"]))
    camera = rig["views"][view]["camera"]
    hit = np.array(camera["camera_from_world"]) @ np.append(rig["laser"]["hits_mm"][position], 1)
    spot = np.array(camera["center_px"]) + camera["focal_px"] * hit[:2] / hit[2]
    brightest = np.unravel_index(np.nanargmax(frame), frame.shape)
    print(f"{frames.shape} {frames.dtype}; the beam hits at column {spot[0]:.1f}, row {spot[1]:.1f};"
          f" brightest is column {brightest[1]}, row {brightest[0]}")
    if len(sys.argv) > 2:
        import matplotlib
        matplotlib.use("Agg")
        import matplotlib.pyplot as plt
        floor = rig["channels"][channel]["noise_floor"]
        plt.imshow(np.log10(np.maximum(frame, floor)), cmap="magma")
        plt.plot(*(spot - 0.5), "c+")
        plt.colorbar(label="log10 radiance")
        plt.savefig(sys.argv[2])


if __name__ == "__main__":
    main()
