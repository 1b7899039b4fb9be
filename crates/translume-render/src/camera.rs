//! Cameras: rays through points of the film, and the importance that light paths need to reach it.
//!
//! Film coordinates are in pixels of the whole film, (0, 0) the upper left corner. A camera looks along its own +z, +y is
//! up and +x is the left of the picture.

use crate::subpath::Density;
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
    /// pixel's value). It is at once the density with which the camera's rays through `p` arrive at the given point, see
    /// [`Camera::density`].
    pub weight: f32,
    /// Where the camera begins to see on the way from `p`: what is between the two does not hide anything.
    pub near: Vec3,
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

    /// Density of the places that the camera's rays arrive at, per area perpendicular to the ray and per pixel area of the
    /// film, at `distance` from the point of the lens along the unit direction `d`.
    #[inline]
    pub fn density(&self, d: Vec3, distance: f32) -> f32 {
        let m = &self.world_from_camera.matrix3;
        let pixel = f64::from(4.0 * self.half.x * self.half.y / (self.size.x * self.size.y)); // its area at z = 1
        let unit = m.determinant().abs() * pixel;
        let density = match self.kind {
            // Rays are uniform over the pixel at z = 1, seen there under the solid angle |det M| A / |M (x, y, 1)|³.
            Kind::Pinhole | Kind::Lens { .. } => {
                let z = self.camera_from_world.matrix3.z_axis.z * f64::from(d.z)
                    + self.camera_from_world.matrix3.y_axis.z * f64::from(d.y)
                    + self.camera_from_world.matrix3.x_axis.z * f64::from(d.x);
                let distance = f64::from(distance);
                1.0 / (unit * z.abs().powi(3) * distance * distance)
            }
            Kind::Parallel => m.z_axis.length() / unit,
        };
        density as f32
    }

    /// How the ray, one of [`Camera::ray`], leads to the place that it meets first.
    pub(crate) fn arrival(&self, ray: &Ray) -> Density {
        let density = self.density(ray.d, 1.0);
        match self.is_parallel() {
            true => Density::Parallel(density),
            false => Density::Angle { from: ray.o, pdf_w: density },
        }
    }

    /// Whether rays start from one place each but all in one direction (the density does not fall with the distance).
    pub fn is_parallel(&self) -> bool {
        matches!(self.kind, Kind::Parallel)
    }

    /// Connects the point `p` of the world to the camera; `None` where it is not seen. `margin` pixels beyond the film's
    /// border count as seen: reconstruction filters reach there.
    pub fn sample_importance(&self, p: Vec3, lens: Vec2, margin: f32) -> Option<CameraSample> {
        let local = self.camera_from_world.transform_point3(p.as_dvec3()).as_vec3();
        let (origin, focus) = match self.kind {
            Kind::Pinhole => (Vec3::ZERO, 1.0),
            Kind::Lens { radius, focus } => ((warp::uniform_disk(lens.x, lens.y) * radius).extend(0.0), focus),
            Kind::Parallel => (local.truncate().extend(0.0), 1.0),
        };
        if !(local.z > self.near && local.z < self.far) {
            return None;
        }
        let toward = local - origin;
        let plane = match self.kind {
            Kind::Parallel => local.truncate(),
            _ => (origin + toward * (focus / toward.z)).truncate() / focus,
        };
        let film = ((Vec2::ONE - plane / self.half) * 0.5 - self.offset) * self.size;
        let inside = film.cmpge(Vec2::splat(-margin)).all() && film.cmplt(self.size + margin).all();
        if !inside {
            return None;
        }
        let to_world = |q: Vec3| self.world_from_camera.transform_point3(q.as_dvec3()).as_vec3();
        let point = to_world(origin);
        let distance = (point - p).length();
        let wi = (point - p) / distance;
        let near = to_world(origin + toward * (self.near / toward.z));
        Some(CameraSample { p: point, wi, film, weight: self.density(-wi, distance), near })
    }
}
