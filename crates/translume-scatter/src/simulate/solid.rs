//! A closed mesh on a turntable: the walk inside it, and what cameras around it see.
//!
//! Light that leaves is counted on the surface, in texels finer than the pixels; frames look these up through rays. So one walk
//! serves all views.

use super::stage::{self, Stage};
use super::walk::{Body, Exit, Interface, Wall};
use super::{CAMERA_DISTANCE, CHANNELS, CaptureParams, LASER_HEIGHT, Medium, channel, shifted};
use crate::capture::{Camera, Capture, Laser, Rig, Surface, Texels, View, dot, normalize, sub};
use glam::Vec3;
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::path::Path;
use translume_core::rng::Pcg32;
use translume_image::{Error, Result};
use translume_mesh::{Topology, TriMesh};

/// The inside of a closed mesh.
pub struct Solid {
    surface: Surface,
    clear: Clearance,
}

impl Solid {
    /// Takes a mesh in mm; it is turned over if its triangles look inwards. `Err` says what keeps it from having an inside.
    pub fn new(mut mesh: TriMesh) -> std::result::Result<Self, String> {
        if let Some(fault) = mesh.fault() {
            return Err(fault);
        }
        let topology = Topology::of(&mesh);
        if topology.boundary_edges > 0 || topology.non_manifold_edges > 0 || topology.flipped_edges > 0 {
            return Err(format!(
                "light needs a closed surface to walk in: {} edges of one triangle, {} of more than two, {} with a triangle \
                 turned over",
                topology.boundary_edges, topology.non_manifold_edges, topology.flipped_edges
            ));
        }
        match topology.volume {
            Some(v) if v > 0.0 => {}
            Some(v) if v < 0.0 => mesh.flip(),
            _ => return Err("the mesh encloses no volume".into()),
        }
        let clear = Clearance::new(&mesh);
        let surface = Surface::new(mesh).ok_or("too many triangles")?;
        Ok(Self { surface, clear })
    }

    /// The mesh, looking outwards.
    pub fn mesh(&self) -> &TriMesh {
        &self.surface.mesh
    }

    /// The same for rays.
    pub(super) fn surface(&self) -> &Surface {
        &self.surface
    }

    /// The box around it.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let b = self.mesh().bounds();
        (b.lo.as_dvec3().to_array(), b.hi.as_dvec3().to_array())
    }

    /// Distance of a place inside to the surface in mm, to about 0.1 mm; more than 1 mm counts as 1 mm.
    pub fn depth(&self, p: [f64; 3]) -> f64 {
        if self.clear.at(p) > 1.0 {
            return 1.0;
        }
        let o = Vec3::from_array(p.map(|x| x as f32));
        // The nearest surface lies close to one of many directions; its plane is closer than along the ray.
        let n = 48;
        let near = (0..n).filter_map(|i| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / f64::from(n);
            let phi = 2.399_963_2 * f64::from(i);
            let s = (1.0 - z * z).sqrt();
            let d = Vec3::new((s * phi.cos()) as f32, (s * phi.sin()) as f32, z as f32);
            self.surface.first(o, d).map(|place| place.distance * f64::from(d.dot(place.normal)).abs())
        });
        near.fold(1.0, f64::min)
    }
}

impl Body for Solid {
    fn enter(&self, origin: [f64; 3], direction: Vec3) -> Option<Wall> {
        let place = self.surface.first(Vec3::from_array(origin.map(|x| x as f32)), direction)?;
        (direction.dot(place.normal) < 0.0).then_some(Wall {
            distance: place.distance,
            at: place.inside,
            normal: place.normal,
            face: place.face,
            uv: place.uv,
        })
    }

    fn wall(&self, p: [f64; 3], direction: Vec3) -> Option<Wall> {
        let place = self.surface.first(Vec3::from_array(p.map(|x| x as f32)), direction)?;
        (direction.dot(place.normal) > 0.0).then_some(Wall {
            distance: place.distance,
            at: place.inside,
            normal: place.normal,
            face: place.face,
            uv: place.uv,
        })
    }

    fn clearance(&self, p: [f64; 3]) -> f64 {
        self.clear.at(p)
    }
}

/// Lower bounds of the distance to the surface, on a grid.
struct Clearance {
    origin: [f64; 3],
    size: [usize; 3],
    cell: f64,
    layers: Vec<u8>,
}

/// Cells along the longest side.
const CELLS: f64 = 72.0;

impl Clearance {
    fn new(mesh: &TriMesh) -> Self {
        let bounds = mesh.bounds();
        let cell = f64::from(bounds.extent().max_element()).max(1e-9) / CELLS;
        let origin = bounds.lo.as_dvec3().to_array().map(|x| x - 1.5 * cell);
        let size = bounds.extent().as_dvec3().to_array().map(|e| (e / cell).ceil() as usize + 3);
        let mut grid = Self { origin, size, cell, layers: vec![u8::MAX; size.iter().product()] };
        let mut front = Vec::new();
        for face in 0..mesh.indices.len() {
            let [a, b, c] = mesh.corners(face).map(|p| p.as_dvec3());
            // Points less than half a cell apart: a cell that none of them is in has one of their cells beside it.
            let n = (((b - a).length().max((c - a).length()).max((c - b).length())) / (0.5 * cell)).ceil().max(1.0);
            for i in 0..=n as usize {
                for j in 0..=n as usize - i {
                    let p = a + (b - a) * (i as f64 / n) + (c - a) * (j as f64 / n);
                    let index = grid.index(p.to_array());
                    if grid.layers[index] != 0 {
                        grid.layers[index] = 0;
                        front.push(index);
                    }
                }
            }
        }
        for layer in 1..=u8::MAX - 1 {
            let mut next = Vec::new();
            for &index in &front {
                grid.neighbours(index, |other, layers| {
                    if layers[other] == u8::MAX {
                        layers[other] = layer;
                        next.push(other);
                    }
                });
            }
            if next.is_empty() {
                break;
            }
            front = next;
        }
        grid
    }

    fn index(&self, p: [f64; 3]) -> usize {
        let i = [0, 1, 2].map(|a| (((p[a] - self.origin[a]) / self.cell).max(0.0) as usize).min(self.size[a] - 1));
        (i[2] * self.size[1] + i[1]) * self.size[0] + i[0]
    }

    fn neighbours(&mut self, index: usize, mut visit: impl FnMut(usize, &mut [u8])) {
        let [nx, ny, nz] = self.size;
        let at = [index % nx, index / nx % ny, index / (nx * ny)];
        let range = |a: usize, n: usize| at[a].saturating_sub(1)..=(at[a] + 1).min(n - 1);
        for k in range(2, nz) {
            for j in range(1, ny) {
                for i in range(0, nx) {
                    visit((k * ny + j) * nx + i, &mut self.layers);
                }
            }
        }
    }

    /// Layer n is n − 1 whole cells from a marked one, which is a cell from the surface at most.
    #[inline]
    fn at(&self, p: [f64; 3]) -> f64 {
        f64::from(self.layers[self.index(p)].saturating_sub(2)) * self.cell
    }
}

/// Rays through a pixel, along each side: small triangles have small texels, and a pixel is to see all of its own.
const RAYS: usize = 4;

/// A solid on its turntable.
struct SolidStage<'a> {
    solid: &'a Solid,
    texels: Texels,
    /// Per view and pixel: texels and radiance per power that leaves there.
    views: Vec<Vec<[(u32, f32); RAYS * RAYS]>>,
    /// Stop of the turntable of each view and of each laser position.
    view_stops: Vec<usize>,
    position_stops: Vec<usize>,
}

impl<'a> SolidStage<'a> {
    fn new(solid: &'a Solid, cameras: &[Camera], interface: &Interface, pixel_mm: f64, stops: [Vec<usize>; 2]) -> Self {
        let texels = Texels::about(solid.mesh(), 0.7 * pixel_mm);
        let area: Vec<f64> = (0..solid.mesh().indices.len())
            .map(|f| {
                let [a, b, c] = solid.mesh().corners(f).map(|p| p.as_dvec3());
                0.5 * (b - a).cross(c - a).length() / texels.per_face() as f64
            })
            .collect();
        let pixel = |camera: &Camera, i: usize| {
            std::array::from_fn(|k| {
                let part = |k: usize| (k as f64 + 0.5) / RAYS as f64;
                let px = [(i % camera.width) as f64 + part(k % RAYS), (i / camera.width) as f64 + part(k / RAYS)];
                solid.surface.seen(camera, px).map_or((0, 0.0), |(place, cos)| {
                    let factor = interface.radiance(cos) / (area[place.face as usize] * (RAYS * RAYS) as f64);
                    (texels.index(place.face, place.uv) as u32, factor as f32)
                })
            })
        };
        let view = |c: &Camera| (0..c.width * c.height).into_par_iter().map(|i| pixel(c, i)).collect();
        let [view_stops, position_stops] = stops;
        Self { solid, texels, views: cameras.iter().map(view).collect(), view_stops, position_stops }
    }
}

impl Stage for SolidStage<'_> {
    type Body = Solid;

    fn body(&self) -> &Solid {
        self.solid
    }

    fn bins(&self) -> usize {
        self.solid.mesh().indices.len() * self.texels.per_face()
    }

    fn record(&self, exit: &Exit, light: &mut [[f64; 3]]) {
        let bin = &mut light[self.texels.index(exit.wall.face, exit.wall.uv)];
        bin.iter_mut().zip(exit.weight).for_each(|(b, w)| *b += w);
    }

    fn frame(&self, view: usize, light: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let pixel = |rays: &[(u32, f32); RAYS * RAYS]| {
            let mut sum = [0.0; 3];
            for &(bin, factor) in rays {
                sum.iter_mut().zip(light[bin as usize]).for_each(|(s, l)| *s += f64::from(factor) * l);
            }
            sum
        };
        self.views[view].iter().map(pixel).collect()
    }

    fn views(&self) -> usize {
        self.view_stops.len()
    }

    fn sees(&self, view: usize, position: usize) -> bool {
        self.view_stops[view] == self.position_stops[position]
    }
}

/// Elevation of the laser and of the cameras above the turntable's plane, and the azimuth of the first camera from the laser.
const LASER_ELEVATION: f64 = 0.44;
const CAMERA_ELEVATION: f64 = 0.61;
const CAMERA_AZIMUTH: f64 = 0.44;
/// Beams that meet the surface at less than this cosine are left out.
const GRAZING: f64 = 0.3;

/// Simulates a capture of a solid on a turntable into the folder `path`, for each of `params.views` stops with
/// `params.cameras` cameras; `spots` and `thickness_mm` do not count here. A laser position belongs to one stop, and only the
/// cameras of that stop have frames of it.
///
/// # Errors
/// [`Error::Invalid`] where no beam meets the mesh; those of writing.
pub fn capture_solid(
    path: &Path,
    (solid, medium): (&Solid, &Medium),
    params: &CaptureParams,
    label: serde_json::Value,
    progress: impl Fn(usize) + Sync,
) -> Result<Capture> {
    let mut errors = Pcg32::new(params.seed, u64::MAX >> 2);
    let (rig, stops) = turntable(solid, params, label);
    if rig.laser.hits_mm.is_empty() {
        return Err(Error::invalid(path, "no beam of the laser's grid meets the mesh; take a smaller spacing"));
    }
    let positions = rig.laser.hits_mm.len();
    let cameras: Vec<Camera> = rig.views.iter().map(|v| shifted(&v.camera, params, &mut errors)).collect();
    let mut mesh = solid.mesh().clone();
    if params.geometry_error_mm > 0.0 {
        mesh.compute_normals();
        let normals = mesh.normals.clone().unwrap_or_default();
        for (p, n) in mesh.positions.iter_mut().zip(normals) {
            let off = (params.geometry_error_mm * errors.next_normal()) as f32;
            p.iter_mut().zip(n).for_each(|(p, n)| *p += off * n);
        }
    }
    let mut capture = Capture::create(path, rig, mesh)?;
    let interface = Interface::new(params.eta, params.rough);
    let pixel_mm = params.field_mm / params.pixels as f64;
    let stage = SolidStage::new(solid, &cameras, &interface, pixel_mm, stops);
    stage::expose(&stage, (medium, &interface), params, &mut capture, || progress(positions))?;
    Capture::create(path, capture.rig, capture.mesh)
}

/// The rig, and the stop of each view and position.
fn turntable(solid: &Solid, params: &CaptureParams, label: serde_json::Value) -> (Rig, [Vec<usize>; 2]) {
    let center = solid.mesh().bounds().center().as_dvec3().to_array();
    let radius = f64::from(solid.mesh().bounds().extent().length()) / 2.0;
    let around = |azimuth: f64, elevation: f64, distance: f64| {
        let d = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
        [0, 1, 2].map(|i| center[i] + distance * d[i])
    };
    let up = [0.0, 0.0, 1.0];
    let (laser_far, camera_far) = (LASER_HEIGHT.max(8.0 * radius), CAMERA_DISTANCE.max(6.0 * radius));
    let half = (radius / params.spacing_mm).ceil() as i64;
    let (mut views, mut hits, mut origins, mut stops) = (Vec::new(), Vec::new(), Vec::new(), [Vec::new(), Vec::new()]);
    for stop in 0..params.views {
        let turn = TAU * stop as f64 / params.views as f64;
        for c in 0..params.cameras {
            let azimuth = turn + CAMERA_AZIMUTH + TAU * c as f64 / params.cameras as f64;
            let eye = around(azimuth, CAMERA_ELEVATION, camera_far);
            let camera = Camera::looking_at(eye, center, up, (params.pixels, params.pixels), params.field_mm);
            // Seen from the object, laser and cameras turn the other way.
            views.push(View { turntable_deg: (-turn).to_degrees(), camera });
            stops[0].push(stop);
        }
        let origin = around(turn, LASER_ELEVATION, laser_far);
        let toward = Camera::looking_at(origin, center, up, (1, 1), 1.0).camera_from_world;
        let axis = |row: usize| [toward[row][0], toward[row][1], toward[row][2]];
        let (right, down) = (axis(0), axis(1));
        for (row, column) in (-half..=half).flat_map(|r| (-half..=half).map(move |c| (r, c))) {
            let offset = |i: usize| params.spacing_mm * (column as f64 * right[i] + row as f64 * down[i]);
            let target = [0, 1, 2].map(|i| center[i] + offset(i));
            let direction = normalize(sub(target, origin));
            let to_single = |v: [f64; 3]| Vec3::from_array(v.map(|x| x as f32));
            let Some(place) = solid.surface.first(to_single(origin), to_single(direction)) else { continue };
            if -dot(direction, place.normal.as_dvec3().to_array()) >= GRAZING {
                hits.push(place.at);
                origins.push(origin);
                stops[1].push(stop);
            }
        }
    }
    let rig = Rig {
        provenance: serde_json::json!({ "simulated": label, "parameters": params }),
        ..Rig::new(
            params.eta,
            CHANNELS.into_iter().map(channel).collect(),
            views,
            Laser {
                origin_mm: around(0.0, LASER_ELEVATION, laser_far),
                origins_mm: origins,
                beam_diameter_mm: params.beam_diameter_mm,
                power: vec![1.0; CHANNELS.len()],
                grid: [2 * half as usize + 1; 2],
                hits_mm: hits,
            },
        )
    };
    (rig, stops)
}
