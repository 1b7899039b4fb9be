//! Agreement with brute force, watertightness, scales, instances, and input that makes no sense.

use crate::lanes::Level;
use crate::*;
use glam::{DAffine3, DVec3, Vec3};
use std::sync::Arc;
use translume_core::rng::Pcg32;
use translume_mesh::TriMesh;

fn unit_vector(rng: &mut Pcg32) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|_| rng.next_normal() as f32)).normalize()
}

fn in_cube(rng: &mut Pcg32) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|_| 2.0 * rng.next_f32() - 1.0))
}

/// `n` random triangles of edge length about `size` in the cube from −1 to 1.
fn soup(n: usize, size: f32, rng: &mut Pcg32) -> TriMesh {
    let mut mesh = TriMesh::default();
    for i in 0..n as u32 {
        let p = in_cube(rng);
        mesh.positions.extend((0..3).map(|_| (p + size * in_cube(rng)).to_array()));
        mesh.indices.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    mesh
}

/// A closed bumpy sphere: an octahedron, each triangle split `levels` times in four.
pub(crate) fn ball(levels: usize, bump: f32) -> TriMesh {
    let mut positions: Vec<Vec3> = vec![Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
    let mut indices: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..levels {
        let mut middles = std::collections::HashMap::new();
        let mut next = Vec::new();
        for [a, b, c] in indices {
            let mut middle = |a: u32, b: u32| {
                *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    positions.push((positions[a as usize] + positions[b as usize]).normalize());
                    positions.len() as u32 - 1
                })
            };
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            next.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        indices = next;
    }
    let bumped = |p: Vec3| p * (1.0 + bump * (9.0 * p.x).sin() * (7.0 * p.y).cos() * (8.0 * p.z).sin());
    TriMesh { positions: positions.into_iter().map(|p| bumped(p).into()).collect(), indices, ..TriMesh::default() }
}

/// Möller–Trumbore in double precision over every triangle: parameter and triangle, and the smallest barycentric
/// coordinate of the hit relative to one.
fn brute_force(mesh: &TriMesh, ray: &Ray) -> Option<(f64, u32)> {
    let (o, d) = (ray.o.as_dvec3(), ray.d.as_dvec3());
    let mut best: Option<(f64, u32)> = None;
    for face in 0..mesh.indices.len() {
        let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
        let p = d.cross(c - a);
        let det = p.dot(b - a);
        let u = p.dot(o - a) / det;
        let q = (o - a).cross(b - a);
        let v = q.dot(d) / det;
        let t = q.dot(c - a) / det;
        let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
        if inside && t > f64::from(ray.t_min) && t < best.map_or(f64::from(ray.t_max), |b| b.0) {
            best = Some((t, face as u32));
        }
    }
    best
}

fn geometry(mesh: TriMesh) -> Geometry {
    Geometry::from_mesh(Arc::new(mesh)).unwrap()
}

/// Runs `check` on the fast and the portable kernels.
fn on_both(mut geometry: Geometry, check: impl Fn(&Geometry)) {
    check(&geometry);
    if geometry.level != Level::Portable {
        geometry.level = Level::Portable;
        check(&geometry);
    }
}

#[test]
fn agrees_with_brute_force_on_soups() {
    let mut rng = Pcg32::new(1, 0);
    for (n, size) in [(1, 1.0), (7, 0.5), (100, 0.4), (2000, 0.1)] {
        let mesh = soup(n, size, &mut rng);
        let rays: Vec<Ray> = (0..2000).map(|_| Ray::new(1.5 * in_cube(&mut rng), unit_vector(&mut rng))).collect();
        on_both(geometry(mesh.clone()), |g| {
            let mut differ = 0;
            for ray in &rays {
                let (got, want) = (g.intersect(ray), brute_force(&mesh, ray));
                assert_eq!(got.is_some(), g.occluded(ray));
                match (got, want) {
                    (Some(hit), Some((t, _))) if (f64::from(hit.t) - t).abs() < 1e-4 => {}
                    (None, None) => {}
                    // A ray through an edge may fall on either side of it in different arithmetic.
                    _ => differ += 1,
                }
            }
            assert!(differ <= 2, "{differ} of {} differ, {n} triangles", rays.len());
        });
    }
}

#[test]
fn limits_are_kept() {
    let mesh = TriMesh {
        positions: vec![[-1.0, -1.0, 5.0], [3.0, -1.0, 5.0], [-1.0, 3.0, 5.0]],
        indices: vec![[0, 1, 2]],
        ..TriMesh::default()
    };
    on_both(geometry(mesh), |g| {
        for (t_min, t_max, hits) in
            [(0.0, f32::INFINITY, true), (0.0, 5.0, false), (0.0, 5.001, true), (5.0, 9.0, false), (4.999, 9.0, true)]
        {
            let ray = Ray { t_min, t_max, ..Ray::new(Vec3::ZERO, Vec3::Z) };
            assert_eq!(g.intersect(&ray).is_some(), hits, "{t_min} {t_max}");
            assert_eq!(g.occluded(&ray), hits);
        }
        let hit = g.intersect(&Ray::new(Vec3::new(0.0, 1.0, 0.0), Vec3::Z * 2.0)).unwrap();
        assert_eq!((hit.t, hit.u, hit.v), (2.5, 0.25, 0.5));
    });
}

/// Rays from inside a closed mesh towards points on its edges and its vertices; all must hit.
fn count_leaks(mesh: &TriMesh, scale: f32, rays: usize, seed: u64) -> usize {
    let g = geometry(mesh.clone());
    let mut rng = Pcg32::new(seed, 7);
    let center = mesh.bounds().center();
    let ray = |i: usize| {
        let corners = mesh.corners(rng.next_u32() as usize % mesh.indices.len());
        // Every third at a vertex, the others at an edge.
        let s = if i.is_multiple_of(3) { 0.0 } else { rng.next_f32() };
        let target = corners[0] + s * (corners[1] - corners[0]);
        let o = center + 0.3 * scale * in_cube(&mut rng);
        Ray::new(o, target - o)
    };
    let rays: Vec<Ray> = (0..rays).map(ray).collect();
    g.intersect_all(&rays).iter().filter(|hit| hit.is_none()).count()
}

#[test]
fn closed_meshes_do_not_leak() {
    assert_eq!(count_leaks(&ball(5, 0.1), 1.0, 2_000_000, 3), 0);
    // Millimetres, kilometres, and far from the origin, where vertices are coarsely rounded.
    for (scale, offset) in [(1e-3, 0.0), (1e3, 0.0), (1.0, 300.0), (1e-3, 1.0), (1e3, 1e5)] {
        let mut mesh = ball(4, 0.1);
        let m = DAffine3::from_translation(DVec3::new(offset, -0.7 * offset, 0.2 * offset))
            * DAffine3::from_scale(DVec3::splat(scale));
        mesh.transform(&m);
        assert_eq!(count_leaks(&mesh, scale as f32, 60_000, 4), 0, "scale {scale} offset {offset}");
    }
}

#[test]
fn flat_and_axis_parallel_boxes_do_not_leak() {
    // A cube: every ray below runs along an axis, through edges, corners and in the planes of boxes.
    let corner = |i: u32| std::array::from_fn(|k| if i >> k & 1 == 0 { -1.0 } else { 1.0 });
    let indices = vec![
        [0, 2, 1],
        [1, 2, 3],
        [4, 5, 6],
        [5, 7, 6],
        [0, 1, 4],
        [1, 5, 4],
        [2, 6, 3],
        [3, 6, 7],
        [0, 4, 2],
        [2, 4, 6],
        [1, 3, 5],
        [3, 7, 5],
    ];
    let cube = TriMesh { positions: (0..8).map(corner).collect(), indices, ..TriMesh::default() };
    on_both(geometry(cube), |g| {
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                let mut d = Vec3::ZERO;
                d[axis] = sign;
                for (a, b) in [(0.0, 0.0), (1.0, 0.0), (0.3, 0.3), (1.0, 1.0), (-1.0, 0.5)] {
                    let mut o = -3.0 * d;
                    (o[(axis + 1) % 3], o[(axis + 2) % 3]) = (a, b);
                    let hit = g.intersect(&Ray::new(o, d));
                    assert_eq!(hit.map(|h| h.t), Some(2.0), "{o} {d}");
                }
            }
        }
    });
}

#[test]
fn grazing_rays_hit_what_double_precision_hits() {
    let mesh = ball(4, 0.0);
    let g = geometry(mesh.clone());
    let mut rng = Pcg32::new(5, 0);
    let mut wrong = 0;
    let n = 3000;
    for i in 0..n {
        // Along a triangle's plane, within half a degree or a few thousandths of one.
        let tilt = if i % 2 == 0 { 1e-2 } else { 1e-4 };
        let corners = mesh.corners(rng.next_u32() as usize % mesh.indices.len());
        let target = (corners[0] + corners[1] + corners[2]) / 3.0;
        let tangent = (corners[1] - corners[0]).normalize() + tilt * unit_vector(&mut rng);
        let ray = Ray::new(target - 2.0 * tangent, tangent);
        let hit = g.intersect(&ray);
        // The parameter is as badly conditioned as the angle is flat, the point is not: it must lie on the ray.
        if let Some(hit) = hit {
            let surface = g.surface(&ray, &hit);
            let off = (surface.p - ray.o).cross(ray.d.normalize()).length();
            let sine = surface.ng.dot(ray.d.normalize()).abs();
            // Roundings of the position divided by the angle: how far it may slide within a triangle, of size 0.1 here.
            assert!(off < 1e-6 + 2e-7 * 0.1 / sine, "{off} {sine}");
        }
        wrong += usize::from(hit.is_some() != brute_force(&mesh, &ray).is_some());
    }
    assert!(wrong * 1000 <= n, "{wrong} of {n}");
}

#[test]
fn instances_agree_with_flattened_copies() {
    let mut rng = Pcg32::new(8, 0);
    let part = soup(200, 0.2, &mut rng);
    let shared = Arc::new(geometry(part.clone()));
    let (mut instances, mut flat) = (Vec::new(), TriMesh::default());
    for i in 0..30 {
        let m = DAffine3::from_translation(4.0 * in_cube(&mut rng).as_dvec3())
            * DAffine3::from_axis_angle(unit_vector(&mut rng).as_dvec3().normalize(), f64::from(i))
            * DAffine3::from_scale(DVec3::new(0.5, 1.0, if i % 2 == 0 { 2.0 } else { -1.5 }));
        instances.push(Instance { geometry: shared.clone(), world_from_object: m });
        let mut copy = part.clone();
        // Keep the winding: triangle numbers and corners must correspond.
        let mirrored = m.matrix3.determinant() < 0.0;
        copy.transform(&m);
        if mirrored {
            copy.indices.iter_mut().for_each(|t| t.swap(1, 2));
        }
        assert!(flat.append(&copy));
    }
    // One that cannot be hit.
    instances.push(Instance { geometry: shared, world_from_object: DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0)) });
    let scene = Scene::new(instances).unwrap();
    let flat = geometry(flat);
    let (mut differ, mut hits) = (0, 0);
    for _ in 0..20_000 {
        let ray = Ray::new(6.0 * in_cube(&mut rng), unit_vector(&mut rng));
        let (a, b) = (scene.intersect(&ray), flat.intersect(&ray));
        assert_eq!(a.is_some(), scene.occluded(&ray));
        match (a, b) {
            (Some(a), Some(b)) if a.instance * 200 + a.prim == b.prim => {
                hits += 1;
                assert!((a.t - b.t).abs() < 1e-4);
                let (p, q) = (scene.surface(&ray, &a), flat.surface(&ray, &b));
                assert!(p.p.distance(q.p) < 1e-4, "{p:?} {q:?}");
                assert!(p.p.distance(ray.at(a.t)) < 1e-4);
                assert!(p.ng.dot(q.ng).abs() > 0.999);
            }
            (None, None) => {}
            _ => differ += 1,
        }
    }
    assert!(hits > 2000 && differ <= 5, "{hits} hits, {differ} differ");
}

#[test]
fn quadrics_are_hit_where_they_are() {
    let shapes = vec![
        Shape::Sphere(Sphere { center: Vec3::new(0.0, 0.0, 5.0), radius: 1.0 }),
        Shape::Disk(Disk { center: Vec3::new(4.0, 0.0, 5.0), normal: Vec3::new(0.0, 0.0, -3.0), radius: 1.0 }),
        Shape::Cylinder(Cylinder { p0: Vec3::new(8.0, -1.0, 5.0), p1: Vec3::new(8.0, 1.0, 5.0), radius: 0.5 }),
        Shape::Mesh(Arc::new(ball(2, 0.0))),
        Shape::Sphere(Sphere { center: Vec3::ZERO, radius: f32::NAN }),
    ];
    on_both(Geometry::new(shapes).unwrap(), |g| {
        let hit = |x: f32, y: f32| g.intersect(&Ray::new(Vec3::new(x, y, 2.0), Vec3::Z)).map(|h| (h.part, h.t));
        assert_eq!(hit(0.0, 0.0), Some((0, 2.0)));
        assert_eq!(hit(1.01, 0.0), None);
        assert_eq!(hit(4.9, 0.3), Some((1, 3.0)));
        assert_eq!(hit(4.9, 0.5), None);
        assert_eq!(hit(8.0, 0.9), Some((2, 2.5)));
        assert_eq!(hit(8.0, 1.1), None);
        // From inside the sphere, the far side; from far away, still precise.
        assert_eq!(g.intersect(&Ray::new(Vec3::new(0.0, 0.0, 5.0), Vec3::Z)).map(|h| h.t), Some(1.0));
        let ray = Ray::new(Vec3::new(0.0, 1e4, 5.0), Vec3::NEG_Y);
        let hit = g.intersect(&ray).unwrap();
        let surface = g.surface(&ray, &hit);
        assert!(surface.p.distance(Vec3::new(0.0, 1.0, 5.0)) < 1e-5);
        assert!(surface.ng.distance(Vec3::Y) < 1e-5);
    });
}

#[test]
fn spawned_rays_do_not_meet_their_own_surface() {
    // Convex shapes: whatever leaves them outwards never comes back.
    let ball = Arc::new(ball(5, 0.0));
    for scale in [1e-3, 1.0, 1e3] {
        for offset in [0.0, 30.0] {
            let m = DAffine3::from_translation(DVec3::new(offset, 0.3 * offset, -offset) * scale)
                * DAffine3::from_rotation_x(0.3)
                * DAffine3::from_scale(DVec3::splat(scale));
            let instance = |geometry| vec![Instance { geometry: Arc::new(geometry), world_from_object: m }];
            let mut moved = (*ball).clone();
            moved.transform(&m);
            let sphere = Shape::Sphere(Sphere { center: Vec3::ZERO, radius: 1.0 });
            let scenes = [
                Scene::of(geometry(moved)).unwrap(),
                Scene::new(instance(Geometry::from_mesh(ball.clone()).unwrap())).unwrap(),
                Scene::new(instance(Geometry::new(vec![sphere]).unwrap())).unwrap(),
            ];
            for (kind, scene) in scenes.iter().enumerate() {
                check_spawned(scene, &format!("kind {kind} scale {scale} offset {offset}"));
            }
        }
    }
}

fn check_spawned(scene: &Scene, what: &str) {
    let mut rng = Pcg32::new(9, 0);
    let (mut own, mut through, mut n) = (0, 0, 0);
    let bounds = scene.bounds();
    for _ in 0..20_000 {
        let d = unit_vector(&mut rng);
        let target = bounds.center() + 0.45 * bounds.extent() * in_cube(&mut rng);
        let ray = Ray::new(target - 2.0 * bounds.extent().x * d, d);
        let Some(hit) = scene.intersect(&ray) else { continue };
        let surface = scene.surface(&ray, &hit);
        assert!(surface.ng.dot(d) < 0.0, "normals point outwards");
        let mut away = unit_vector(&mut rng);
        if away.dot(surface.ng) < 0.0 {
            away = -away;
        }
        n += 1;
        own += usize::from(scene.intersect(&surface.spawn(away)).is_some());
        // Inwards, the ray must find the other side, once.
        let inwards = surface.spawn(-away);
        match scene.intersect(&inwards) {
            None => through += 1,
            Some(second) => {
                let exit = scene.surface(&inwards, &second);
                through += usize::from(exit.ng.dot(away) > 0.0);
                // The segment between both touches neither.
                own += usize::from(scene.occluded(&surface.segment_between(&exit)));
            }
        }
    }
    assert!(n > 5000, "{what}: {n} hits");
    // Directions within a rounding of the tangent plane may go either way.
    assert!(own <= 2 && through * 500 <= n, "{what}: {own} self hits, {through} lost of {n}");
}

#[test]
fn nothing_is_hit_in_an_empty_scene() {
    let ray = Ray::new(Vec3::ZERO, Vec3::Z);
    let empty = Geometry::new(vec![]).unwrap();
    assert_eq!((empty.intersect(&ray), empty.occluded(&ray)), (None, false));
    let scene = Scene::of(empty).unwrap();
    assert_eq!((scene.intersect(&ray), scene.occluded(&ray)), (None, false));
    assert!(scene.bounds().is_empty());
    assert_eq!(Scene::new(vec![]).unwrap().intersect(&ray), None);
}

#[test]
fn senseless_rays_and_triangles_are_harmless() {
    let mut mesh = ball(2, 0.0);
    let n = mesh.positions.len() as u32;
    mesh.positions.extend([[f32::NAN, 0.0, 0.0], [f32::INFINITY, 0.0, 0.0], [3e38, -3e38, 3e38]]);
    mesh.indices.extend([[0, 1, n], [0, 1, n + 1], [0, 0, 1], [2, 2, 2], [0, 1, n + 2]]);
    on_both(geometry(mesh), |g| {
        let odd = [0.0, -0.0, 1.0, f32::NAN, f32::INFINITY, f32::MIN_POSITIVE, 1e-42, 3e38];
        for ox in odd {
            for dx in odd {
                for dy in odd {
                    for t_max in [1.0, f32::INFINITY, f32::NAN, -1.0, 0.0] {
                        let ray = Ray { o: Vec3::new(ox, 0.1, 0.1), d: Vec3::new(dx, dy, 0.0), t_min: 0.0, t_max };
                        let hit = g.intersect(&ray);
                        assert!(hit.is_none_or(|h| h.t < t_max && h.t > 0.0));
                    }
                }
            }
        }
        assert!(g.intersect(&Ray::new(Vec3::new(0.1, 0.2, -5.0), Vec3::Z)).is_some());
    });
}

#[test]
fn many_equal_triangles_build_a_bounded_tree() {
    // Nothing to split by: the build must fall back to halving.
    let one = TriMesh {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![[0, 1, 2]; 5000],
        ..TriMesh::default()
    };
    let g = geometry(one);
    assert_eq!(g.intersect(&Ray::new(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z)).map(|h| h.t), Some(1.0));
    // Triangles that shrink geometrically towards a corner make the deepest trees of the heuristic.
    let mut mesh = TriMesh::default();
    for i in 0..140_u32 {
        let s = 0.5_f32.powi(i as i32);
        mesh.positions.extend([[s, s, 0.0], [0.9 * s, s, 0.0], [s, 0.9 * s, 0.1 * s]]);
        mesh.indices.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    let g = geometry(mesh.clone());
    let c = mesh.corners(3);
    let target = (c[0] + c[1] + c[2]) / 3.0;
    assert!(g.intersect(&Ray::new(target + Vec3::Z, Vec3::NEG_Z)).is_some());
}

#[test]
fn batches_answer_like_single_rays() {
    let mut rng = Pcg32::new(2, 2);
    let g = geometry(soup(500, 0.3, &mut rng));
    let rays: Vec<Ray> = (0..3000).map(|_| Ray::new(in_cube(&mut rng), unit_vector(&mut rng))).collect();
    let single: Vec<_> = rays.iter().map(|r| g.intersect(r)).collect();
    assert_eq!(g.intersect_all(&rays), single);
    assert_eq!(g.occluded_all(&rays), single.iter().map(Option::is_some).collect::<Vec<_>>());
}
