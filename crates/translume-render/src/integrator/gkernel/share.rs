//! Camera paths of neighbouring pixels share what they find beyond their first surface, and only some of them look for
//! it.
//!
//! Source: Bekaert, Sbert, Halton 2002: Accelerating path tracing by re-using paths. The camera paths of a group of
//! pixels have their first vertices at x_1 … x_m. Some of them, the representatives C, go on past their second vertices
//! y_j. Where y_j is Lambertian, what leaves it is the same towards all x_i that it sees from one side, so that each
//! gets Σ_{j ∈ C} f_i(y_j) G V / S(y_j) times what path j found beyond, S(y) = Σ_{k ∈ C} p_k(y) V_k(y): the balance
//! heuristic for |C| samples of one integral.
//!
//! What representatives hardly find is not left to them: y is shared with x_i ([`Group`]) only if p_i(y) ≤ S(y) times
//! [`MAX_OWN`]; if not, path i goes on alone. Since that depends on x_1 … x_m and y only, and links at x_i to y ask the
//! same, nothing is lost and nothing counts twice.
//!
//! Weights of links and emitter sampling depend on where a path comes from. They must sum to one for each path (x_i,
//! y_j, …), but what was found beyond y_j is one number. So all take the weights that the first representative would
//! have, with |C| times its density of y; links at x_i to a shared y as well.

use super::eye::EyeVertex;
use crate::Rgb;
use crate::subpath::{NONE, Vertex, scattering};
use crate::world::{Shading, SurfaceHit, World};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;
use translume_bxdf::Flags;

/// Smallest cosine between the normals of a group, and largest distance over that of the camera.
const MIN_COS: f32 = 0.8;
const MAX_APART: f32 = 0.25;

/// Largest density of a path that leaves the rest to representatives, over theirs.
const MAX_OWN: f32 = 1.0;

/// First surface of a camera path that takes part.
pub(crate) struct ReuseTarget<'a> {
    /// Number of the camera path.
    pub(crate) path: u32,
    vertex: Vertex,
    shading: Shading<'a>,
}

/// What the first vertex of a camera path has in common with others.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Group {
    /// Number of the first representative's vertex.
    pub(crate) first: u32,
    /// Of the next representative's, if this is a representative's itself.
    pub(crate) next: Option<u32>,
    /// It is one.
    pub(crate) is_representative: bool,
    /// How many there are.
    pub(crate) representatives: f32,
}

/// What camera path `path` gets of what was found beyond the second vertex of another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SuffixShare {
    pub(crate) suffix: u32,
    pub(crate) path: u32,
    pub(crate) factor: Rgb,
}

/// How a camera path goes on past its second vertex.
pub(crate) enum Continuation {
    /// For itself.
    Alone,
    /// Others do it.
    Ends,
    /// For all of these paths, with their factors; weights are to see these first two vertices.
    Shared(Box<[Vertex; 2]>, Vec<(u32, Rgb)>),
}

impl<'a> ReuseTarget<'a> {
    /// That of a walk of path number `path`, at most `most` segments: where it meets its first surface, unless that may
    /// let it pass.
    pub(crate) fn of(world: &'a World, path: u32, walk: &[Vertex], most: u32) -> Option<Self> {
        let vertex = *walk.first()?;
        let shading = world.shading(&vertex.hit);
        let usable = shading.flags().has_smooth() && !shading.flags().contains(Flags::NULL);
        (usable && vertex.segments + 1 < most && vertex.pdf > 0.0).then_some(Self { path, vertex, shading })
    }

    /// Whether it can be in a group with `other`, seen from the camera at `from`.
    pub(crate) fn resembles(&self, other: &Self, from: Vec3) -> bool {
        let (own, other, near) = (&self.vertex, &other.vertex, other.vertex.hit.point.p - from);
        let apart = own.hit.point.p.distance_squared(other.hit.point.p);
        own.segments == other.segments
            && own.hit.n().dot(other.hit.n()) >= MIN_COS
            && apart <= near.length_squared() * (MAX_APART * MAX_APART)
    }
}

/// How `walk`, that of `group[own]`, goes on past its second vertex; the first `representatives` of the group are
/// those.
pub(crate) fn continuation(
    world: &World,
    (group, representatives, own): (&[ReuseTarget], usize, usize),
    walk: &[Vertex],
    rays: &mut u64,
) -> Continuation {
    let [x, y] = walk else { return Continuation::Alone };
    let first = &group[0].vertex;
    if x.delta || y.parent != 0 || y.passed < 1.0 || y.segments != x.segments + 1 {
        return Continuation::Alone;
    }
    let shading = world.shading(&y.hit);
    let side_of = |r: &ReuseTarget| side(&y.hit, &shading, r.vertex.hit.point.p);
    let (Some(pdf), true) = (
        Step::new(world, &first.hit, &group[0].shading, &y.hit).map(|s| s.pdf),
        shading.is_lambertian() && side_of(&group[own]) == side_of(&group[0]),
    ) else {
        return Continuation::Alone;
    };
    let on = side_of(&group[0]);
    let mut step = |i: usize| {
        let from = (&group[i].vertex.hit, &group[i].shading);
        if i == own {
            Step::new(world, from.0, from.1, &y.hit)
        } else {
            Step::seen(world, from, (&y.hit, &shading), on, rays)
        }
    };
    if own >= representatives {
        let Some(bound) = step(own).map(|s| s.pdf) else { return Continuation::Alone };
        let covered = is_covered(bound, (0..representatives).filter_map(step));
        return if covered { Continuation::Ends } else { Continuation::Alone };
    }
    let mut sum = 0.0;
    let mut shares = Vec::with_capacity(group.len());
    for (i, target) in group.iter().enumerate() {
        let Some(step) = step(i) else { continue };
        if i < representatives {
            sum += step.pdf;
        } else if step.pdf > MAX_OWN * sum {
            continue;
        }
        shares.push((target.path, target.vertex.throughput * step.value));
    }
    if !shares.iter().any(|(path, _)| *path == group[own].path) {
        return Continuation::Alone;
    }
    shares.iter_mut().for_each(|(_, factor)| *factor /= sum);
    let to_first = first.hit.point.p - y.hit.point.p;
    let wo = to_first.normalize();
    let onto_first =
        shading.frame.n.dot(wo).abs() * FRAC_1_PI * first.hit.n().dot(wo).abs() / to_first.length_squared();
    let seen_first = Vertex { pdf_back: onto_first, parent: NONE, delta: false, ..*first };
    let seen = Vertex {
        hit: SurfaceHit { wo, ..y.hit },
        throughput: Rgb::splat(1.0 / y.survival),
        pdf: pdf * representatives as f32,
        ..*y
    };
    Continuation::Shared(Box::new([seen_first, seen]), shares)
}

impl Group {
    /// The camera vertex whose weights a link from `y` to the surface at `hit` takes, if it is one that paths share,
    /// and the factor on its density; `clear`: nothing at all is in between.
    pub(crate) fn representative<'e, 'a>(
        &self,
        world: &World,
        (y, eyes): (&EyeVertex, &'e [EyeVertex<'a>]),
        (hit, shading): (&SurfaceHit, &Shading),
        clear: impl Fn() -> bool,
        rays: &mut u64,
    ) -> Option<(&'e EyeVertex<'a>, f32)> {
        let first = &eyes[self.first as usize];
        let (p, q) = (y.hit.point.p, first.hit.point.p);
        let seen = world.shading_from(hit, shading, (p - hit.point.p).normalize_or_zero());
        let own_side = side(hit, &seen, p);
        let shared = seen.is_lambertian()
            && own_side == side(hit, &seen, q)
            && Step::new(world, &first.hit, &first.shading, hit).is_some()
            && clear();
        if !shared {
            return None;
        }
        if self.is_representative {
            return Some((first, self.representatives));
        }
        let bound = Step::new(world, &y.hit, &y.shading, hit)?.pdf;
        let next =
            |representative: &&EyeVertex<'a>| representative.group.and_then(|g| g.next).map(|i| &eyes[i as usize]);
        let steps = std::iter::successors(Some(first), next)
            .filter_map(|c| Step::seen(world, (&c.hit, &c.shading), (hit, &seen), own_side, rays));
        is_covered(bound, steps).then_some((first, self.representatives))
    }
}

/// Whether a path that finds a place with density `own` leaves it to the representatives that take these steps there.
fn is_covered(own: f32, mut representatives: impl Iterator<Item = Step>) -> bool {
    let mut sum = 0.0;
    representatives.any(|step| {
        sum += step.pdf;
        own <= MAX_OWN * sum
    })
}

/// The sides of the surface and of its shading frame that `from` is on.
fn side(hit: &SurfaceHit, shading: &Shading, from: Vec3) -> [bool; 2] {
    [hit.n(), shading.frame.n].map(|n| n.dot(from - hit.point.p) > 0.0)
}

/// From x to y.
struct Step {
    /// f |cos| per area at y.
    value: Rgb,
    /// Density per area.
    pdf: f32,
}

impl Step {
    /// From where the surface `y` is seen `on` these sides, with nothing in between.
    fn seen(
        world: &World,
        (x, shading): (&SurfaceHit, &Shading),
        (y, y_shading): (&SurfaceHit, &Shading),
        on: [bool; 2],
        rays: &mut u64,
    ) -> Option<Self> {
        if side(y, y_shading, x.point.p) != on {
            return None;
        }
        let step = Self::new(world, x, shading, y)?;
        *rays += 1;
        world.is_clear(&x.point.segment_between(&y.point)).then_some(step)
    }

    fn new(world: &World, x: &SurfaceHit, shading: &Shading, y: &SurfaceHit) -> Option<Self> {
        let way = y.point.p - x.point.p;
        let d2 = way.length_squared();
        let wi = way / d2.sqrt();
        let here = scattering(world, x, shading, wi, x.wo)?;
        let onto = y.n().dot(wi).abs() / d2;
        let (value, pdf) = (here.f * (x.n().dot(wi).abs() * onto), here.pdf_to_light * onto);
        (pdf > 0.0 && pdf.is_finite()).then_some(Self { value, pdf })
    }
}
