"""The cases of the bench: name, exposure times, views, true displacements."""
from dataclasses import dataclass, field
import numpy as np
import simulate as sim

THREE = [1 / 60, 1 / 15, 1 / 4]


@dataclass
class Case:
    name: str
    views: list  # radiance per shot
    secs: list
    forth: list  # where anchor pixels lie in each shot
    known: list  # where that is defined
    anchor: int = 1
    depth: str = "8 bit"
    shots: list = field(default_factory=list)  # what the camera wrote

    def photograph(self, seed):
        self.shots = [sim.expose(v, t, np.random.default_rng([seed, i]), self.depth) for i, (v, t) in enumerate(zip(self.views, self.secs))]
        return self


def moved(scene, frame, maps, name, secs=THREE, objects=None, **more):
    """A case whose shots see the scene (with an object at `objects[i]` pixels) through `maps`."""
    everywhere = np.ones((frame[3], frame[2]), bool)
    thing = sim.Object(scene, frame) if objects else None
    views, known = [], []
    anchor = more.get("anchor", 1)
    for i, (back, _) in enumerate(maps):
        views.append(sim.view(thing.put(scene, objects[i]) if thing else scene, frame, back))
        known.append(~(thing.hides(objects[i]) | thing.hides(objects[anchor])) if thing else everywhere)
    return Case(name, views, secs, [m[1] for m in maps], known, **more)


def series(scene, frame, n):
    """n pictures, two stops apart (one and a third for nine), each held a little differently."""
    rng = np.random.default_rng(n)
    step = 2 if n < 9 else 4 / 3
    secs = [sim.WHITE_SECS * 2 ** (step * (i - n // 2)) for i in range(n)]
    pose = lambda i: sim.rigid(frame, *((0, 0, 0) if i == n // 2 else (rng.uniform(-1, 1), *rng.uniform(-12, 12, 2))))
    return moved(scene, frame, [pose(i) for i in range(n)], f"{n} pictures", secs, anchor=n // 2)


def cases(scene):
    """name -> a function that makes the case, in the order of the table."""
    frame = sim.frame_of(scene)
    w = frame[2]
    still = sim.rigid(frame, 0, 0, 0)
    shift = [sim.rigid(frame, 0, 11.5, -7.25), still, sim.rigid(frame, 0, -9, 13.5)]
    turn = lambda a: [sim.rigid(frame, a, 8, 5), still, sim.rigid(frame, -0.8 * a, -12, 6)]
    hand = [sim.rigid(frame, 0.8, 6, -9), still, sim.rigid(frame, -0.6, -7, 5)]
    floor = [sim.depth_ramp(frame, 14), still, sim.depth_ramp(frame, -14)]
    object_at = [-0.16 * w, 0, 0.19 * w]

    def layers(name="large parallax, 60 px"):
        world = sim.Layers(scene, frame)
        shots = [world.shot(60, 10), world.shot(0, 0), world.shot(-48, -8)]
        return Case(name, [s[0] for s in shots], THREE, [s[1] for s in shots], [s[2] for s in shots])

    make = lambda maps, name, **more: lambda: moved(scene, frame, maps, name, **more)
    table = {
        "still": make([still] * 3, "still"),
        "shift": make(shift, "shift"),
        "turn 2°": make(turn(2), "turn 2°"),
        "parallax": make(floor, "parallax"),
        "moving object": make([still] * 3, "moving object", objects=object_at),
        "hand-held + moving": make(hand, "hand-held + moving", objects=object_at),
        "turn 5°": make(turn(5), "turn 5°"),
        "turn 10°": make(turn(10), "turn 10°"),
        "3 pictures": lambda: series(scene, frame, 3),
        "5 pictures": lambda: series(scene, frame, 5),
        "9 pictures": lambda: series(scene, frame, 9),
        "16-bit PNG": make(hand, "16-bit PNG", depth="16 bit", objects=object_at),
        "linear EXR": make(hand, "linear EXR", depth="linear", objects=object_at),
        "large parallax, 60 px": layers,
    }
    return table
