"""A floor of a building with thousands of lamps, as a Mitsuba scene: after the scene of figure 6 of Bekaert et al. 2003.

Rooms lie on both sides of a corridor, in two rows each, with doors to the corridor and to their neighbours. Every room has
its ceiling lamps, every one an area light of its own, and stools and vases. The camera stands in a room of the front row.
Which doors are open decides how many lamps reach the view:

    shut   none but the camera's room's own: 2 % of the lamps
    half   the nearest rooms' and that part of the corridor: 20 %
    open   all of them

As a program it writes one such scene; `glossy` makes the floors rough metal. The same seed gives the same files.
"""
import argparse, math, os, random, struct

SETTINGS = ("shut", "half", "open")
COLUMNS, ROWS = 13, 4  # rooms; the corridor runs between rows 1 and 2
WIDTH, DEPTH, HEIGHT, CORRIDOR = 5.0, 4.0, 2.8, 2.4  # metres
WALL, DOOR, DOOR_HEIGHT = 0.1, 1.0, 2.1
LAMPS = (10, 6)  # a room's, along x and y
VIEW = (6, 1)  # the camera's room: column, row


class Mesh:
    """Triangles of one material, written as a binary PLY with normals where given."""

    def __init__(self):
        self.vertices, self.faces = [], []

    def quad(self, a, b, c, d):
        n = len(self.vertices)
        self.vertices += [a, b, c, d]
        self.faces += [(n, n + 1, n + 2), (n, n + 2, n + 3)]

    def box(self, lo, hi):
        (x, y, z), (u, v, w) = lo, hi
        self.quad((x, y, z), (x, v, z), (u, v, z), (u, y, z))
        self.quad((x, y, w), (u, y, w), (u, v, w), (x, v, w))
        self.quad((x, y, z), (u, y, z), (u, y, w), (x, y, w))
        self.quad((x, v, z), (x, v, w), (u, v, w), (u, v, z))
        self.quad((x, y, z), (x, y, w), (x, v, w), (x, v, z))
        self.quad((u, y, z), (u, v, z), (u, v, w), (u, y, w))

    def turned(self, center, profile, around):
        """A solid of revolution about a vertical axis; profile: (radius, height) from below."""
        n = len(self.vertices)
        for radius, z in profile:
            for k in range(around):
                angle = 2 * math.pi * k / around
                self.vertices.append((center[0] + radius * math.cos(angle), center[1] + radius * math.sin(angle), z))
        for i in range(len(profile) - 1):
            for k in range(around):
                a, b = n + i * around + k, n + i * around + (k + 1) % around
                self.faces += [(a, b, b + around), (a, b + around, a + around)]

    def write(self, path):
        with open(path, "wb") as f:
            f.write((f"ply\nformat binary_little_endian 1.0\nelement vertex {len(self.vertices)}\nproperty float x\nproperty float y\n"
                     f"property float z\nelement face {len(self.faces)}\nproperty list uchar int vertex_indices\nend_header\n").encode())
            f.write(b"".join(struct.pack("<3f", *v) for v in self.vertices))
            f.write(b"".join(struct.pack("<B3i", 3, *face) for face in self.faces))


def room_place(column, row):
    """Lower corner of a room; the corridor lies below row 2."""
    return column * WIDTH, row * DEPTH + (CORRIDOR if row >= 2 else 0.0)


def wall(mesh, a, b, opening):
    """A wall from a to b (along an axis), with a doorway in its middle unless `opening` is None; a leaf fills it if False."""
    along = 0 if a[1] == b[1] else 1
    length = b[along] - a[along]

    def piece(begin, end, low, high, thickness=WALL):
        lo, hi = [a[0], a[1], low], [a[0], a[1], high]
        lo[along], hi[along] = a[along] + begin, a[along] + end
        lo[1 - along] -= thickness / 2
        hi[1 - along] += thickness / 2
        mesh.box(lo, hi)

    if opening is None:
        return piece(0, length, 0, HEIGHT)
    begin, end = (length - DOOR) / 2, (length + DOOR) / 2
    piece(0, begin, 0, HEIGHT)
    piece(end, length, 0, HEIGHT)
    piece(begin, end, DOOR_HEIGHT, HEIGHT)
    if not opening:
        piece(begin, end, 0, DOOR_HEIGHT, WALL / 2)


def reached(setting):
    """The rooms whose lamps reach the view."""
    column, row = VIEW
    if setting == "shut":
        return {VIEW}
    if setting == "half":  # ten of 52
        return {(c, r) for r in range(ROWS) for c in range(column - 1, column + 2)} - {(column - 1, 3), (column + 1, 3)}
    return {(c, r) for r in range(ROWS) for c in range(COLUMNS)}


def furniture(random_, walls, vases, stools, x, y):
    for _ in range(5):
        place = (x + random_.uniform(0.5, WIDTH - 0.5), y + random_.uniform(0.5, DEPTH - 0.5))
        size = random_.uniform(0.7, 1.3)
        vases.turned(place, [(0.16 * size * (1 + 0.5 * math.sin(3.6 * t / 16)) * (1 - 0.5 * (t / 16) ** 2), 0.6 * size * t / 16) for t in range(17)], 36)
    for _ in range(3):
        place = (x + random_.uniform(0.5, WIDTH - 0.5), y + random_.uniform(0.5, DEPTH - 0.5))
        stools.turned(place, [(0.0, 0.45), (0.2, 0.45), (0.22, 0.43), (0.2, 0.41), (0.04, 0.40), (0.03, 0.05), (0.18, 0.03), (0.2, 0.0)], 24)
    shelf = x + random_.uniform(0.3, WIDTH - 1.5)
    for level in range(4):
        walls.box((shelf, y + 0.06, 0.4 * level + 0.3), (shelf + 1.0, y + 0.3, 0.4 * level + 0.33))


def floor(folder, setting, seed=1, glossy=False, size=(512, 384)):
    """Writes `floor.xml` and its meshes into `folder`; the path, and what there is of triangles and lamps."""
    os.makedirs(folder, exist_ok=True)
    random_ = random.Random(seed)
    walls, ground, vases, stools = Mesh(), Mesh(), Mesh(), Mesh()
    long, deep = COLUMNS * WIDTH, ROWS * DEPTH + CORRIDOR
    ground.quad((0, 0, 0), (long, 0, 0), (long, deep, 0), (0, deep, 0))
    walls.quad((0, 0, HEIGHT), (0, deep, HEIGHT), (long, deep, HEIGHT), (long, 0, HEIGHT))
    seen = reached(setting)
    opened = lambda *rooms: all(r in seen for r in rooms) and setting != "shut"
    for row in range(ROWS):
        for column in range(COLUMNS):
            x, y = room_place(column, row)
            here, side, up = (column, row), (column + 1, row), (column, row + 1)
            if column + 1 < COLUMNS:
                wall(walls, (x + WIDTH, y), (x + WIDTH, y + DEPTH), opened(here, side))
            if row == 1:
                wall(walls, (x, y + DEPTH), (x + WIDTH, y + DEPTH), opened(here))
            elif row == 2:
                wall(walls, (x, y), (x + WIDTH, y), opened(here))
            if row in (0, 2):
                wall(walls, (x, y + DEPTH), (x + WIDTH, y + DEPTH), opened(here, up))
            furniture(random_, walls, vases, stools, x, y)
    for a, b in (((0, 0), (long, 0)), ((0, deep), (long, deep)), ((0, 0), (0, deep)), ((long, 0), (long, deep))):
        wall(walls, a, b, None)
    lamps = []
    for row in range(ROWS):
        for column in range(COLUMNS):
            x, y = room_place(column, row)
            for i in range(LAMPS[0]):
                for j in range(LAMPS[1]):
                    lamps.append((x + WIDTH * (i + 0.5) / LAMPS[0], y + DEPTH * (j + 0.5) / LAMPS[1], random_.uniform(4.0, 8.0)))
    meshes = {"walls": walls, "ground": ground, "vases": vases, "stools": stools}
    for name, mesh in meshes.items():
        mesh.write(os.path.join(folder, f"{name}.ply"))
    x, y = room_place(*VIEW)
    shapes = []
    for name, material in (("walls", "wall"), ("ground", "ground"), ("vases", "vase"), ("stools", "stool")):
        shapes.append(f'<shape type="ply"><string name="filename" value="{name}.ply"/><boolean name="face_normals" value="true"/>'
                      f'<ref id="{material}"/></shape>')
    for lx, ly, power in lamps:
        shapes.append(f'<shape type="rectangle"><transform name="to_world"><scale x="0.06" y="0.06"/><rotate x="1" angle="180"/>'
                      f'<translate x="{lx:.4f}" y="{ly:.4f}" z="{HEIGHT - 0.02}"/></transform><ref id="wall"/>'
                      f'<emitter type="area"><rgb name="radiance" value="{power:.3f} {0.9 * power:.3f} {0.75 * power:.3f}"/></emitter></shape>')
    ground_bsdf = ('<bsdf type="roughconductor"><string name="material" value="Al"/><string name="distribution" value="ggx"/><float name="alpha" value="0.15"/></bsdf>'
                   if glossy else '<bsdf type="diffuse"><rgb name="reflectance" value="0.4 0.3 0.22"/></bsdf>')
    diffuse = lambda name, rgb: f'<bsdf type="twosided" id="{name}"><bsdf type="diffuse"><rgb name="reflectance" value="{rgb}"/></bsdf></bsdf>'
    # The camera stands in a corner and sees the doors to the corridor and to the next room.
    scene = f"""<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="8"/></integrator>
<sensor type="perspective"><float name="fov" value="75"/>
<transform name="to_world"><lookat origin="{x + 0.5}, {y + 0.5}, 1.6" target="{x + 3.4}, {y + DEPTH}, 1.1" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="width" value="{size[0]}"/><integer name="height" value="{size[1]}"/><rfilter type="box"/></film>
<sampler type="independent"><integer name="sample_count" value="16"/></sampler></sensor>
{diffuse("wall", "0.7 0.7 0.68")}{diffuse("vase", "0.25 0.4 0.55")}{diffuse("stool", "0.6 0.25 0.15")}
<bsdf type="twosided" id="ground">{ground_bsdf}</bsdf>
{chr(10).join(shapes)}
</scene>
"""
    path = os.path.join(folder, "floor.xml")
    with open(path, "w") as f:
        f.write(scene)
    triangles = sum(len(m.faces) for m in meshes.values()) + 2 * len(lamps)
    return path, {"triangles": triangles, "lamps": len(lamps), "reached": len(seen) * LAMPS[0] * LAMPS[1]}


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder")
    arguments.add_argument("--setting", choices=SETTINGS, default="open")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--glossy", action="store_true")
    arguments = arguments.parse_args()
    print(*floor(arguments.folder, arguments.setting, arguments.seed, arguments.glossy))
