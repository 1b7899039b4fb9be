//! Cameras: rays through points of the film, and the importance that light paths need to reach it.
//!
//! Film coordinates are in pixels of the whole film, (0, 0) the upper left corner. A camera looks along its own +z, +y is
//! up and +x is the left of the picture.

use glam::{DAffine3, Vec2, Vec3};
use translume_core::warp;
use translume_scene::sensor::{Projection, Sensor};
use translume_trace::Ray;

/// A camera, compiled for a film size.
#[derive(Clone, Debug)]
pub struct Camera {
    world_from_camera: DAffine3,
    camera_from_world: DAffine3,
    size: Vec2,
    /// Half the film's extents at z = 1 (for parallel projection: of the picture itself).
    half: Vec2,
    /// Where the optical axis meets the film, in widths and heights from its middle.
    offset: Vec2,
    kind: Kind,
    near: f32,
    far: f32,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Pinhole,
    Lens { radius: f32, focus: f32 },
    Parallel,
}

/// How a point in the world sees the camera, for light paths: the answer of [`Camera::sample_importance`].
#[derive(Clone, Copy, Debug)]
pub struct CameraSample {
    /// A point of the lens.
    pub p: Vec3,
    /// Unit direction from the given point to `p`.
    pub wi: Vec3,
    /// Place on the film.
    pub film: Vec2,
    /// Emitted importance W_e over the density of `p` per solid angle at the given point: what a contribution
    /// radiance·f·cos is multiplied by, in pixels of the film (the sum over all light paths, divided by their number, is the
    /// pixel's value).
    pub weight: f32,
    /// Density per solid angle of [`Camera::ray`] for the direction −`wi` at `p`, per pixel area of the film.
    pub pdf_w: f32,
}

impl Camera {
    /// Compiles `sensor` for a film of `size` pixels.
    pub fn new(sensor: &Sensor, size: [u32; 2]) -> Self {
        let extent = Vec2::new(size[0] as f32, size[1] as f32);
        let aspect = extent.x / extent.y;
        let opening = |p: &translume_scene::sensor::Perspective| {
            let x = (0.5 * p.fov_x(size[0], size[1])).tan();
            (Vec2::new(x, x / aspect), Vec2::from(p.principal_point_offset))
        };
        let (half, offset, kind) = match &sensor.projection {
            Projection::Perspective(p) => (opening(p).0, opening(p).1, Kind::Pinhole),
            Projection::ThinLens { perspective: p, aperture_radius, focus_distance } => {
                (opening(p).0, opening(p).1, Kind::Lens { radius: *aperture_radius, focus: *focus_distance })
            }
            Projection::Orthographic => (Vec2::new(1.0, 1.0 / aspect), Vec2::ZERO, Kind::Parallel),
        };
        Self {
            world_from_camera: sensor.world_from_camera,
            camera_from_world: sensor.world_from_camera.inverse(),
            size: extent,
            half,
            offset,
            kind,
            near: sensor.near_clip,
            far: sensor.far_clip,
        }
    }

    /// The ray through `film`; `lens` in [0, 1)² chooses a point of the aperture. Its direction has length one.
    pub fn ray(&self, film: Vec2, lens: Vec2) -> Ray {
        let s = Vec2::ONE - 2.0 * (film / self.size + self.offset);
        let plane = s * self.half;
        let (o, d) = match self.kind {
            Kind::Pinhole => (Vec3::ZERO, plane.extend(1.0)),
            Kind::Lens { radius, focus } => {
                let o = (warp::uniform_disk(lens.x, lens.y) * radius).extend(0.0);
                (o, (plane * focus).extend(focus) - o)
            }
            Kind::Parallel => (plane.extend(0.0), Vec3::Z),
        };
        // The limits are distances along the axis; t counts length in the world.
        let o = self.world_from_camera.transform_point3(o.as_dvec3()).as_vec3();
        let along = self.world_from_camera.transform_vector3(d.as_dvec3());
        let per_z = (along.length() / f64::from(d.z)) as f32;
        Ray { o, d: along.normalize().as_vec3(), t_min: self.near * per_z, t_max: self.far * per_z }
    }

    /// Connects the point `p` of the world to the camera; `None` where it is not seen.
    pub fn sample_importance(&self, p: Vec3, lens: Vec2) -> Option<CameraSample> {
        let local = self.camera_from_world.transform_point3(p.as_dvec3()).as_vec3();
        let (origin, focus) = match self.kind {
            Kind::Pinhole => (Vec3::ZERO, 1.0),
            Kind::Lens { radius, focus } => ((warp::uniform_disk(lens.x, lens.y) * radius).extend(0.0), focus),
            Kind::Parallel => (local.truncate().extend(0.0), 1.0),
        };
        if local.z <= self.near || local.z >= self.far {
            return None;
        }
        let plane = match self.kind {
            Kind::Parallel => local.truncate(),
            _ => {
                let toward = local - origin;
                (origin + toward * (focus / toward.z)).truncate() / focus
            }
        };
        let film = ((Vec2::ONE - plane / self.half) * 0.5 - self.offset) * self.size;
        if film.min_element() < 0.0 || film.x >= self.size.x || film.y >= self.size.y {
            return None;
        }
        let point = self.world_from_camera.transform_point3(origin.as_dvec3()).as_vec3();
        let distance = (point - p).length();
        let wi = (point - p) / distance;
        let pixel = 4.0 * self.half.x * self.half.y / (self.size.x * self.size.y); // area of a pixel at z = 1
        let scale = self.world_from_camera.matrix3.determinant().abs() as f32;
        let unit = scale.cbrt();
        let cos = (local - origin).normalize().z;
        let (pdf_w, weight) = match self.kind {
            // Directions are uniform over the pixel at z = 1: density 1/(A cos³); W_e is that per pixel and divided by the
            // cosine, the distance comes from the lens point's density 1 (a point) or 1/(πr²) and cancels as for light.
            Kind::Pinhole | Kind::Lens { .. } => {
                let pdf_w = 1.0 / (pixel * cos.powi(3));
                (pdf_w, pdf_w / (distance * distance))
            }
            Kind::Parallel => (f32::INFINITY, 1.0 / (pixel * unit * unit)),
        };
        Some(CameraSample { p: point, wi, film, weight, pdf_w })
    }
}
