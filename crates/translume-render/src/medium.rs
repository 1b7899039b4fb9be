//! Free flight through participating media.
//!
//! Source: majorant tracking with null collisions (Woodcock 1965; Miller, Georgiev & Jarosz 2019). Homogeneous media have
//! their extinction as majorant, so that flights are analytic. Grids have a coarse grid of majorants that a DDA walks.

use crate::Rgb;
use glam::{DAffine3, Vec3};
use translume_bxdf::Phase;
use translume_core::sampler::Sampler;
use translume_scene::medium::{Medium, Samples, Volume};
use translume_scene::texture::Filter;
use translume_trace::Ray;

/// A compiled medium.
pub(crate) struct Tracked {
    medium: Medium,
    majorants: Option<Majorants>,
}

/// Upper bounds of the extinction on a coarse grid over the unit cube.
struct Majorants {
    grid_from_world: DAffine3,
    size: [usize; 3],
    values: Vec<f32>,
}

/// What a tentative collision found: the coefficients there, and what led to it.
pub(crate) struct Collision {
    pub(crate) p: Vec3,
    pub(crate) sigma_s: Rgb,
    pub(crate) sigma_a: Rgb,
    pub(crate) sigma_maj: Rgb,
    /// Transmittance of the majorant since the last collision.
    pub(crate) t_maj: Rgb,
}

/// Cells of the coarse grid along an axis, at most.
const COARSE: usize = 32;

impl Tracked {
    pub(crate) fn new(medium: &Medium) -> Self {
        Self { majorants: Majorants::new(medium), medium: medium.clone() }
    }

    pub(crate) fn phase(&self) -> &Phase {
        &self.medium.phase
    }

    /// Extinction and albedo at a point of the world.
    fn coefficients(&self, p: Vec3) -> (Rgb, Rgb) {
        let sigma_t = value(&self.medium.sigma_t, p) * self.medium.scale;
        (sigma_t, value(&self.medium.albedo, p).clamp(Rgb::ZERO, Rgb::ONE))
    }

    /// Draws tentative collisions along `ray`, distances by the majorant of channel `hero`, until `visit` wants no more
    /// (`None`) or the ray's end is reached: the majorant's transmittance since the last collision.
    pub(crate) fn track(
        &self,
        ray: &Ray,
        t_end: f32,
        hero: usize,
        sampler: &mut impl Sampler,
        mut visit: impl FnMut(&Collision, &mut dyn FnMut() -> f32) -> bool,
    ) -> Option<Rgb> {
        let length = ray.d.length();
        let mut t_maj = Rgb::ONE;
        let mut segment = |t0: f32, t1: f32, sigma_maj: Rgb, t_maj: &mut Rgb, sampler: &mut dyn FnMut() -> f32| {
            let mut t = t0;
            loop {
                let step = if sigma_maj[hero] > 0.0 {
                    -(1.0 - sampler()).max(f32::MIN_POSITIVE).ln() / (sigma_maj[hero] * length)
                } else {
                    f32::INFINITY
                };
                let next = t + step;
                if next >= t1 || !next.is_finite() {
                    let rest = ((t1 - t).max(0.0) * length).min(f32::MAX);
                    *t_maj *= exp(-sigma_maj * rest);
                    return true;
                }
                *t_maj *= exp(-sigma_maj * ((next - t) * length));
                let p = ray.at(next);
                let (sigma_t, albedo) = self.coefficients(p);
                let sigma_t = sigma_t.min(sigma_maj); // interpolation may round above the bound
                let (sigma_s, sigma_a) = (sigma_t * albedo, sigma_t * (Rgb::ONE - albedo));
                if !visit(&Collision { p, sigma_s, sigma_a, sigma_maj, t_maj: *t_maj }, sampler) {
                    return false;
                }
                *t_maj = Rgb::ONE;
                t = next;
            }
        };
        let mut draw = || sampler.next_1d();
        let completed = match &self.majorants {
            None => segment(ray.t_min, t_end, self.medium.majorant(), &mut t_maj, &mut draw),
            Some(m) => m.walk(ray, t_end, |t0, t1, bound| segment(t0, t1, Rgb::splat(bound), &mut t_maj, &mut draw)),
        };
        completed.then_some(t_maj)
    }
}

fn exp(v: Rgb) -> Rgb {
    Rgb::new(v.x.exp(), v.y.exp(), v.z.exp())
}

impl Majorants {
    /// `None` for media of constant extinction.
    fn new(medium: &Medium) -> Option<Self> {
        let Volume::Grid { grid, world_from_grid, samples, .. } = &medium.sigma_t else { return None };
        let size = grid.size.map(|n| n.clamp(1, COARSE));
        let mut values = Vec::with_capacity(size.iter().product());
        // Samples that interpolation may use anywhere in the cell, one more on each side for rounding.
        let range = |i: usize, axis: usize| {
            let (n, cells) = (grid.size[axis] as f64, size[axis] as f64);
            let at = |x: f64| match samples {
                Samples::Centers => x * n - 0.5,
                Samples::Corners => x * (n - 1.0),
            };
            let lo = (at(i as f64 / cells).floor() - 1.0).max(0.0) as usize;
            let hi = ((at((i + 1) as f64 / cells).ceil() + 1.0).max(0.0) as usize).min(grid.size[axis] - 1);
            lo.min(hi)..=hi
        };
        for z in 0..size[2] {
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let mut most = 0.0_f32;
                    for k in range(z, 2) {
                        for j in range(y, 1) {
                            let row = (k * grid.size[1] + j) * grid.size[0];
                            let (first, last) = (row + range(x, 0).start(), row + range(x, 0).end());
                            let cells = &grid.values[first * grid.channels..(last + 1) * grid.channels];
                            most = cells.iter().copied().fold(most, f32::max);
                        }
                    }
                    values.push(most * medium.scale);
                }
            }
        }
        Some(Self { grid_from_world: world_from_grid.inverse(), size, values })
    }

    /// Walks the cells along `ray` (Amanatides & Woo 1987) and hands the part in each with its bound to `visit`, until that
    /// returns false; whether it never did.
    fn walk(&self, ray: &Ray, t_end: f32, mut visit: impl FnMut(f32, f32, f32) -> bool) -> bool {
        let o = self.grid_from_world.transform_point3(ray.o.as_dvec3());
        let d = self.grid_from_world.transform_vector3(ray.d.as_dvec3());
        let (mut t0, mut t1) = (f64::from(ray.t_min), f64::from(t_end));
        for a in 0..3 {
            if d[a] == 0.0 {
                if !(0.0..=1.0).contains(&o[a]) {
                    return true;
                }
                continue;
            }
            let (near, far) = (-o[a] / d[a], (1.0 - o[a]) / d[a]);
            (t0, t1) = (t0.max(near.min(far)), t1.min(near.max(far)));
        }
        if t0 >= t1 {
            return true;
        }
        let start = o + d * t0;
        let cells = self.size.map(|n| n as f64);
        let mut cell: [i64; 3] =
            std::array::from_fn(|a| ((start[a] * cells[a]).floor() as i64).clamp(0, self.size[a] as i64 - 1));
        while t0 < t1 {
            // The next border that is crossed, and its axis.
            let border = |a: usize| match d[a] {
                v if v > 0.0 => ((cell[a] + 1) as f64 / cells[a] - o[a]) / v,
                v if v < 0.0 => (cell[a] as f64 / cells[a] - o[a]) / v,
                _ => f64::INFINITY,
            };
            let (axis, next) =
                (0..3).map(|a| (a, border(a))).fold((0, f64::INFINITY), |m, b| if b.1 < m.1 { b } else { m });
            let end = next.min(t1).max(t0);
            let at = |a: usize| cell[a] as usize;
            let bound = self.values[(at(2) * self.size[1] + at(1)) * self.size[0] + at(0)];
            if end > t0 && bound > 0.0 && !visit(t0 as f32, end as f32, bound) {
                return false;
            }
            t0 = end;
            cell[axis] += if d[axis] > 0.0 { 1 } else { -1 };
            if cell[axis] < 0 || cell[axis] >= self.size[axis] as i64 {
                break;
            }
        }
        true
    }
}

/// A volume's value at a point of the world; zero outside a grid's box.
fn value(volume: &Volume, p: Vec3) -> Rgb {
    let (grid, world_from_grid, samples, filter) = match volume {
        Volume::Constant(rgb) => return *rgb,
        Volume::Grid { grid, world_from_grid, samples, filter } => (grid, world_from_grid, samples, filter),
    };
    let q = world_from_grid.inverse().transform_point3(p.as_dvec3());
    if q.min_element() < 0.0 || q.max_element() > 1.0 {
        return Rgb::ZERO;
    }
    let place: [(usize, usize, f32); 3] = std::array::from_fn(|a| {
        let n = grid.size[a];
        let x = match samples {
            Samples::Centers => q[a] * n as f64 - 0.5,
            Samples::Corners => q[a] * (n - 1) as f64,
        }
        .clamp(0.0, (n - 1) as f64);
        let x = if *filter == Filter::Nearest { x.round() } else { x };
        let i = (x as usize).min(n - 1);
        (i, (i + 1).min(n - 1), (x - i as f64) as f32)
    });
    let mut sum = Rgb::ZERO;
    for corner in 0..8 {
        let pick = |a: usize| {
            let (lo, hi, t) = place[a];
            if corner >> a & 1 == 0 { (lo, 1.0 - t) } else { (hi, t) }
        };
        let ((x, wx), (y, wy), (z, wz)) = (pick(0), pick(1), pick(2));
        let i = ((z * grid.size[1] + y) * grid.size[0] + x) * grid.channels;
        let v = match grid.channels {
            1 => Rgb::splat(grid.values[i]),
            _ => Rgb::from_slice(&grid.values[i..]),
        };
        sum += v * (wx * wy * wz);
    }
    sum
}
