//! Free flight through participating media.
//!
//! Source: majorant tracking with null collisions (Woodcock 1965; Miller, Georgiev & Jarosz 2019). Homogeneous media have
//! their extinction as majorant, so that flights are analytic. Grids have a coarse grid of majorants that a DDA walks; where one
//! of those would mean many collisions, the part of the ray in its cell is halved until what the grid can be at most there
//! means few ([`Majorants::refine`]). So a flight takes steps by the logarithm of the densest cell, not by its density.

mod grid;

use crate::Rgb;
use glam::{DAffine3, DVec3, Vec3};
use grid::{Bound, Samples3};
use translume_bxdf::Phase;
use translume_core::sampler::Sampler;
use translume_scene::medium::{Medium, Volume};
use translume_trace::Ray;

/// A compiled medium.
pub(crate) struct Tracked {
    scale: f32,
    phase: Phase,
    /// Where the medium ends whatever encloses it: to its unit cube.
    domain_from_world: Option<DAffine3>,
    sigma_t: Field,
    albedo: Field,
    majorants: Option<Majorants>,
}

/// A compiled volume.
enum Field {
    Constant(Rgb),
    Grid { samples: Samples3, grid_from_world: DAffine3 },
}

/// Upper bounds of the extinction on a coarse grid over the unit cube.
struct Majorants {
    size: [usize; 3],
    values: Vec<f32>,
}

/// A ray in double precision: steps in dense media are shorter than what single precision tells apart.
#[derive(Clone, Copy)]
struct Line {
    o: DVec3,
    d: DVec3,
}

/// A part of a ray with what bounds the extinction there.
#[derive(Clone, Copy)]
struct Part {
    t0: f64,
    t1: f64,
    bound: Rgb,
    /// The extinction is taken to be the bound.
    even: bool,
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

/// Tentative collisions that a part of a ray may mean before it is halved.
const MANY: f64 = 16.0;

/// Halvings of the part of a ray in one cell. What is left is as long as rounding, and taken to be even.
const MOST_HALVINGS: u32 = 48;

impl Tracked {
    pub(crate) fn new(medium: &Medium) -> Self {
        let sigma_t = Field::new(&medium.sigma_t);
        Self {
            scale: medium.scale,
            phase: medium.phase,
            domain_from_world: medium.domain.map(|m| m.inverse()),
            majorants: Majorants::new(&sigma_t, medium.scale),
            sigma_t,
            albedo: Field::new(&medium.albedo),
        }
    }

    pub(crate) fn phase(&self) -> &Phase {
        &self.phase
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
        let line = Line { o: ray.o.as_dvec3(), d: ray.d.as_dvec3() };
        let length = line.d.length();
        let mut t_maj = Rgb::ONE;
        let mut draw = || sampler.next_1d();
        let mut cross = |part: Part| {
            let Part { t0: mut t, t1, bound, even } = part;
            loop {
                let free = -f64::from((1.0 - draw()).max(f32::MIN_POSITIVE).ln());
                let step = if bound[hero] > 0.0 { free / (f64::from(bound[hero]) * length) } else { f64::INFINITY };
                let next = t + step;
                if next >= t1 || !next.is_finite() {
                    t_maj *= transmittance(bound, (t1 - t).max(0.0) * length);
                    return true;
                }
                t_maj *= transmittance(bound, (next - t) * length);
                let p = line.o + line.d * next;
                // Interpolation may round above the bound.
                let sigma_t = if even { bound } else { (self.sigma_t.at(p) * self.scale).min(bound) };
                let albedo = self.albedo.at(p).clamp(Rgb::ZERO, Rgb::ONE);
                let (sigma_s, sigma_a) = (sigma_t * albedo, sigma_t * (Rgb::ONE - albedo));
                if !visit(&Collision { p: p.as_vec3(), sigma_s, sigma_a, sigma_maj: bound, t_maj }, &mut draw) {
                    return false;
                }
                t_maj = Rgb::ONE;
                t = next;
            }
        };
        let completed = match self.inside(&line, (ray.t_min.into(), t_end.into())) {
            None => true,
            Some((t0, t1)) => match (&self.majorants, &self.sigma_t) {
                (Some(majorants), Field::Grid { samples, grid_from_world }) => {
                    let line = Line {
                        o: grid_from_world.transform_point3(line.o),
                        d: grid_from_world.transform_vector3(line.d),
                    };
                    let scaled = |p: DVec3, q: DVec3| scaled(samples.bound(p, q), self.scale);
                    majorants.walk(&line, (t0, t1), |t0, t1, most| {
                        let part = Part { t0, t1, bound: Rgb::splat(most), even: false };
                        refine(&line, part, length, &scaled, &mut cross)
                    })
                }
                (_, Field::Constant(rgb)) => cross(Part { t0, t1, bound: *rgb * self.scale, even: true }),
                (None, Field::Grid { .. }) => true, // not made
            },
        };
        completed.then_some(t_maj)
    }

    /// The part of a ray between `t0` and `t1` that is in the medium's domain.
    fn inside(&self, line: &Line, (t0, t1): (f64, f64)) -> Option<(f64, f64)> {
        match &self.domain_from_world {
            None => Some((t0, t1)),
            Some(m) => clip(&Line { o: m.transform_point3(line.o), d: m.transform_vector3(line.d) }, (t0, t1)),
        }
    }
}

fn scaled(bound: Bound, scale: f32) -> Bound {
    Bound { most: bound.most.map(|most| most * scale), middle: bound.middle * scale }
}

/// Hands `part` to `cross`, halved where its bound means many collisions and halves have lower ones; false as soon as `cross` is.
fn refine(
    line: &Line,
    part: Part,
    length: f64,
    bound: &impl Fn(DVec3, DVec3) -> Bound,
    cross: &mut impl FnMut(Part) -> bool,
) -> bool {
    if f64::from(part.bound.max_element()) * (part.t1 - part.t0) * length <= MANY {
        return cross(part);
    }
    // The halves that are still to come, the nearest last.
    let mut waiting = vec![(part, 0)];
    while let Some((part, halvings)) = waiting.pop() {
        let Part { t0, t1, bound: most, .. } = part;
        let collisions = |most: Rgb| f64::from(most.max_element()) * (t1 - t0) * length;
        let here = bound(line.o + line.d * t0, line.o + line.d * t1);
        let most = here.most.map_or(most, |b| Rgb::splat(b).min(most));
        let middle = 0.5 * (t0 + t1);
        if collisions(most) <= MANY {
            if most.max_element() > 0.0 && !cross(Part { bound: most, ..part }) {
                return false;
            }
        } else if halvings >= MOST_HALVINGS || middle <= t0 || middle >= t1 {
            if !cross(Part { bound: here.middle, even: true, ..part }) {
                return false;
            }
        } else {
            waiting.push((Part { t0: middle, bound: most, ..part }, halvings + 1));
            waiting.push((Part { t1: middle, bound: most, ..part }, halvings + 1));
        }
    }
    true
}

fn transmittance(sigma: Rgb, length: f64) -> Rgb {
    let of = |s: f32| ((-f64::from(s) * length) as f32).exp();
    Rgb::new(of(sigma.x), of(sigma.y), of(sigma.z))
}

/// Where a ray of the unit cube's space is inside of it.
fn clip(line: &Line, (mut t0, mut t1): (f64, f64)) -> Option<(f64, f64)> {
    for a in 0..3 {
        if line.d[a] == 0.0 {
            if !(0.0..=1.0).contains(&line.o[a]) {
                return None;
            }
            continue;
        }
        let (near, far) = (-line.o[a] / line.d[a], (1.0 - line.o[a]) / line.d[a]);
        (t0, t1) = (t0.max(near.min(far)), t1.min(near.max(far)));
    }
    (t0 < t1).then_some((t0, t1))
}

impl Field {
    fn new(volume: &Volume) -> Self {
        match volume {
            Volume::Constant(rgb) => Self::Constant(*rgb),
            Volume::Grid { grid, world_from_grid, samples, filter, wrap } => Self::Grid {
                samples: Samples3 { grid: grid.clone(), at: *samples, filter: *filter, wrap: *wrap },
                grid_from_world: world_from_grid.inverse(),
            },
        }
    }

    /// The value at a point of the world.
    fn at(&self, p: DVec3) -> Rgb {
        match self {
            Self::Constant(rgb) => *rgb,
            Self::Grid { samples, grid_from_world } => samples.value(grid_from_world.transform_point3(p)),
        }
    }
}

impl Majorants {
    /// `None` for media of constant extinction.
    fn new(sigma_t: &Field, scale: f32) -> Option<Self> {
        let Field::Grid { samples, .. } = sigma_t else { return None };
        let size = samples.grid.size.map(|n| n.clamp(1, COARSE));
        let mut values = Vec::with_capacity(size.iter().product());
        let touched = |i: usize, axis: usize| {
            let cells = size[axis] as f64;
            samples.touched(axis, i as f64 / cells, (i + 1) as f64 / cells)
        };
        let by_axis: [Vec<Vec<usize>>; 3] = std::array::from_fn(|a| (0..size[a]).map(|i| touched(i, a)).collect());
        for z in &by_axis[2] {
            for y in &by_axis[1] {
                values.extend(by_axis[0].iter().map(|x| samples.most(x, y, z) * scale));
            }
        }
        Some(Self { size, values })
    }

    /// Walks the cells along the ray (Amanatides & Woo 1987), which is of the grid's space, and hands the part in each with its
    /// bound to `visit`, until that returns false; whether it never did.
    fn walk(&self, line: &Line, span: (f64, f64), mut visit: impl FnMut(f64, f64, f32) -> bool) -> bool {
        let Some((mut t0, t1)) = clip(line, span) else { return true };
        let Line { o, d } = *line;
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
            if end > t0 && bound > 0.0 && !visit(t0, end, bound) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use translume_core::rng::Pcg32;
    use translume_scene::medium::{Grid, Samples};
    use translume_scene::texture::{Filter, Wrap};

    struct Random(Pcg32);

    impl Sampler for Random {
        fn next_1d(&mut self) -> f32 {
            self.0.next_f32()
        }

        fn next_2d(&mut self) -> glam::Vec2 {
            glam::Vec2::new(self.0.next_f32(), self.0.next_f32())
        }
    }

    fn medium(values: Vec<f32>, size: [usize; 3], wrap: Wrap) -> Medium {
        Medium {
            name: String::new(),
            sigma_t: Volume::Grid {
                grid: Arc::new(Grid { size, channels: 1, values }),
                world_from_grid: DAffine3::IDENTITY,
                samples: Samples::Centers,
                filter: Filter::Bilinear,
                wrap,
            },
            albedo: Volume::Constant(Rgb::ZERO),
            scale: 1.0,
            phase: Phase::Isotropic,
            domain: None,
        }
    }

    /// The part of `n` flights along x that gets through, and the steps of a flight.
    fn through(medium: &Medium, y: f32, n: u32) -> (f64, f64) {
        let tracked = Tracked::new(medium);
        let mut random = Random(Pcg32::new(7, 0));
        let ray = Ray::new(Vec3::new(-1.0, y, 0.5), Vec3::X);
        let (mut passed, mut steps) = (0, 0);
        for _ in 0..n {
            let rest = tracked.track(&ray, f32::INFINITY, 0, &mut random, |c, draw| {
                steps += 1;
                draw() >= c.sigma_a.x / c.sigma_maj.x
            });
            passed += u32::from(rest.is_some());
        }
        (f64::from(passed) / f64::from(n), f64::from(steps) / f64::from(n))
    }

    #[test]
    fn flights_end_in_the_densest_cell_and_pass_beside_it_as_computed() {
        for dense in [1e3, 1e7, 1e30, 3e38] {
            // Thin but for one sample in the middle.
            let mut values = vec![1.0; 5 * 5];
            values[2 * 5 + 2] = dense;
            let grid = medium(values, [5, 5, 1], Wrap::Clamp);
            let (passed, steps) = through(&grid, 0.5, 2000);
            assert!(passed == 0.0 && steps < 60.0, "{dense}: {passed} by {steps} steps");
            // Along the border the dense sample has no weight: an optical depth of one.
            let (passed, steps) = through(&grid, 0.1, 20_000);
            assert!((passed - (-1.0_f64).exp()).abs() < 0.012, "{dense}: {passed}");
            assert!(steps < 60.0, "{dense}: {steps} steps");
        }
    }

    /// A ramp from 0 to m over the length 1/2 has the depth m/4: the halves that are drawn from must not change it.
    #[test]
    fn halving_leaves_the_transmittance() {
        for most in [4.0_f32, 40.0, 400.0] {
            let grid = medium(vec![0.0, most], [2, 1, 1], Wrap::Clamp);
            let tracked = Tracked::new(&grid);
            let mut random = Random(Pcg32::new(9, 1));
            let (lo, hi) = (0.25, 0.25 + (0.5 / most).sqrt() * 0.9);
            let depth = most * (hi - 0.25) * (hi - 0.25); // ∫ 2 m (x − ¼)
            let (mut passed, n) = (0, 40_000);
            for _ in 0..n {
                let ray = Ray { o: Vec3::new(0.0, 0.5, 0.5), d: Vec3::X, t_min: lo, t_max: hi };
                let rest = tracked.track(&ray, hi, 0, &mut random, |c, draw| draw() >= c.sigma_a.x / c.sigma_maj.x);
                passed += u32::from(rest.is_some());
            }
            let passed = passed as f32 / n as f32;
            assert!((passed - (-depth).exp()).abs() < 0.01, "{most}: {passed} for {}", (-depth).exp());
        }
    }

    #[test]
    fn outside_of_its_domain_is_nothing() {
        let mut even = medium(vec![1.0], [1, 1, 1], Wrap::Clamp);
        even.sigma_t = Volume::Constant(Rgb::splat(2.0));
        even.domain = Some(DAffine3::IDENTITY);
        let (passed, _) = through(&even, 0.5, 20_000);
        assert!((passed - (-2.0_f64).exp()).abs() < 0.01, "{passed}");
        assert_eq!(through(&even, 1.5, 10).0, 1.0);
    }
}
