//! Fall-off that depends on the direction [Fuchs 2005, Eq. 3]: segments with hat weights.
//!
//! Segment l of m is centred at the azimuth 2π l/m; between two centres their fall-offs are blended linearly. First each
//! segment is fitted alone, its samples weighted by its hat; then, which the paper does not do, all amplitudes and rates
//! are refined together on the blended model, since that is what is evaluated. In the normal equations a segment meets only
//! its two neighbours, but at some fifty unknowns a dense factorisation costs less than the samples.

use crate::curve::Exponentials;
use crate::exponential::{PreparedSum, Sums, to_exponentials};
use crate::lanes::{Block, LANES, with_avx2};
use crate::lm::{Limits, Problem, minimise};
use crate::radial::{Datum, Family, MAX_PARAMETERS, SMALLEST, Scratch, Squares, punish};
use std::f64::consts::TAU;

/// A sample with its direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Directed {
    /// Distance in mm.
    pub(crate) r: f64,
    /// Natural logarithm of the value.
    pub(crate) ln: f64,
    /// The segment whose centre is the last before the sample's azimuth.
    pub(crate) segment: usize,
    /// Weight of the segment after it, in [0, 1).
    pub(crate) blend: f64,
}

/// Segment before the azimuth of (x, y) and weight of the one after, for `m` segments.
#[inline]
pub fn hat(x: f64, y: f64, m: usize) -> (usize, f64) {
    if m == 1 {
        return (0, 0.0);
    }
    let at = (y.atan2(x).rem_euclid(TAU) / TAU * m as f64).min(m as f64 * (1.0 - f64::EPSILON));
    (at as usize, at.fract()) // w_l of [Fuchs 2005, Eq. 3]
}

/// The samples of segment `l` of `m`, weighted by its hat.
pub(crate) fn samples_of(samples: &[Directed], l: usize, m: usize, out: &mut Vec<Datum>) {
    out.clear();
    out.extend(samples.iter().filter_map(|s| {
        let weight = match () {
            () if m == 1 => 1.0,
            () if s.segment == l => 1.0 - s.blend,
            () if (s.segment + 1) % m == l => s.blend,
            () => 0.0,
        };
        (weight > 0.0).then_some(Datum { r: s.r, ln: s.ln, weight })
    }));
}

/// All segments together, each a sum of its own number of terms.
struct Blended<'a> {
    /// Sorted by segment.
    samples: &'a [Directed],
    families: Vec<Sums>,
    /// Where the parameters of each segment begin, and their number at the end.
    offsets: Vec<usize>,
    /// Segments that stay as they are.
    fixed: &'a [bool],
    /// The largest integral over a plane of the blend, which is the mean of those of its segments.
    most: Option<f64>,
}

impl Problem for Blended<'_> {
    fn parameters(&self) -> usize {
        self.offsets[self.families.len()]
    }

    fn linearise(&self, x: &[f64], normal: &mut [f64], gradient: &mut [f64]) -> Option<f64> {
        let m = self.families.len();
        let part = |l: usize| self.offsets[l]..self.offsets[l + 1];
        let prepared: Vec<_> = (0..m).map(|l| self.families[l].prepare(&x[part(l)])).collect::<Option<_>>()?;
        let mut cost = 0.0;
        for group in self.samples.chunk_by(|a, b| a.segment == b.segment) {
            let near = group[0].segment;
            let far = (near + 1) % m;
            let pair = [near, far].map(|l| Side { family: &self.families[l], at: &prepared[l], fixed: self.fixed[l] });
            let offsets = [near, far].map(|l| self.offsets[l]);
            // Three terms at most on both sides is the usual case, worth a size of its own.
            let size = part(near).len() + part(far).len();
            cost += match size <= 12 {
                true => add_pair::<12>(group, &pair, offsets, normal, gradient)?,
                false => add_pair::<{ 2 * MAX_PARAMETERS }>(group, &pair, offsets, normal, gradient)?,
            };
        }
        Some(cost + self.excess(&prepared, normal, gradient))
    }
}

impl Blended<'_> {
    /// Adds what is too bright to the normal equations.
    fn excess(&self, prepared: &[PreparedSum], normal: &mut [f64], gradient: &mut [f64]) -> f64 {
        let Some(most) = self.most else { return 0.0 };
        let mut by = vec![0.0; self.parameters()];
        let mut total = 0.0;
        for (l, at) in prepared.iter().enumerate() {
            let n = self.families[l].parameters() / 2;
            let (of_segment, derivatives) = self.families[l].total(n, at);
            total += of_segment / prepared.len() as f64;
            if !self.fixed[l] {
                let own = &mut by[self.offsets[l]..self.offsets[l + 1]];
                own.iter_mut().zip(derivatives).for_each(|(b, d)| *b = d / prepared.len() as f64);
            }
        }
        if total <= most {
            return 0.0;
        }
        by.iter_mut().for_each(|b| *b /= total);
        punish(self.samples.len() as f64, (total / most).ln(), &by, normal, gradient)
    }
}

/// A segment on one side of a sample.
struct Side<'a> {
    family: &'a Sums,
    at: &'a PreparedSum,
    fixed: bool,
}

/// Adds the samples between two segments' centres to the normal equations; their sum of squares.
fn add_pair<const N: usize>(
    group: &[Directed],
    pair: &[Side<'_>; 2],
    offsets: [usize; 2],
    normal: &mut [f64],
    gradient: &mut [f64],
) -> Option<f64> {
    let mut sums = Squares::<N>::new();
    if !sum_pair(group, pair, &mut sums) {
        return None;
    }
    let n = gradient.len();
    let sizes = [pair[0].family.parameters(), pair[1].family.parameters()];
    // A parameter without derivatives is not moved.
    let fixed = |i: usize| pair[usize::from(i >= sizes[0])].fixed;
    // Where parameter i of the pair is among all.
    let at = |i: usize| if i < sizes[0] { offsets[0] + i } else { offsets[1] + i - sizes[0] };
    for a in (0..sizes[0] + sizes[1]).filter(|&a| !fixed(a)) {
        gradient[at(a)] += sums.right(a);
        for b in (a..sizes[0] + sizes[1]).filter(|&b| !fixed(b)) {
            let (row, column) = (at(a).min(at(b)), at(a).max(at(b)));
            normal[row * n + column] += sums.product(a, b);
        }
    }
    Some(sums.cost())
}

/// `false` where the blend is not positive.
fn sum_pair<const N: usize>(group: &[Directed], pair: &[Side<'_>; 2], sums: &mut Squares<N>) -> bool {
    with_avx2!([const N: usize], sum_pair_here,
        (group: &[Directed], pair: &[Side<'_>; 2], sums: &mut Squares<N>) -> bool)
}

#[inline(always)]
fn sum_pair_here<const N: usize>(group: &[Directed], pair: &[Side<'_>; 2], sums: &mut Squares<N>) -> bool {
    let [near, far] = pair;
    let sizes = [near.family.parameters(), far.family.parameters()];
    let zero: Block = [0.0; LANES];
    let (mut r, mut ln, mut weight, mut blend) = (zero, zero, zero, zero);
    let (mut near_values, mut far_values, mut values) = (zero, zero, zero);
    let mut j = [zero; N];
    for block in group.chunks(LANES) {
        for l in 0..LANES {
            let s = block[l.min(block.len() - 1)];
            (r[l], ln[l], blend[l]) = (s.r, s.ln, s.blend);
            weight[l] = if l < block.len() { 1.0 } else { 0.0 };
        }
        let (near_j, far_j) = j.split_at_mut(sizes[0]);
        near.family.blocks(sizes[0] / 2, near.at, &r, &mut near_values, near_j);
        far.family.blocks(sizes[1] / 2, far.at, &r, &mut far_values, far_j);
        near_j.iter_mut().for_each(|j| (0..LANES).for_each(|l| j[l] *= 1.0 - blend[l]));
        far_j[..sizes[1]].iter_mut().for_each(|j| (0..LANES).for_each(|l| j[l] *= blend[l]));
        for l in 0..LANES {
            values[l] = (1.0 - blend[l]) * near_values[l] + blend[l] * far_values[l];
        }
        if !values.iter().all(|v| *v >= SMALLEST) {
            return false;
        }
        sums.add(&values, &ln, &weight, &j);
    }
    true
}

/// Refines sums that were fitted apart on all samples together, but for those that are `fixed`; left as they are where that
/// finds nothing sound. At least three segments: with two, a segment is both neighbours of the other.
pub(crate) fn refine(
    samples: &mut [Directed],
    segments: &mut [Exponentials],
    (fixed, most): (&[bool], Option<f64>),
    scratch: &mut Scratch,
) {
    let reach = samples.iter().map(|s| s.r).fold(0.0, f64::max);
    samples.sort_by_key(|s| s.segment);
    let mut offsets = vec![0];
    let mut x = Vec::new();
    for s in segments.iter() {
        x.extend(&s.c);
        x.extend(s.d.iter().map(|d| (-d).ln()));
        offsets.push(x.len());
    }
    let families: Vec<Sums> = segments.iter().map(|s| Sums::new(s.c.len(), reach, None)).collect();
    let problem = Blended { samples, families, offsets, fixed, most };
    // Along a bound the steps are short.
    let limits = match most {
        None => Limits { steps: 25, tolerance: 1e-4 },
        Some(_) => Limits { steps: 150, tolerance: 1e-6 },
    };
    if minimise(&problem, &mut x, limits, &mut scratch.lm).is_none() {
        return;
    }
    let part = |l: usize| &x[problem.offsets[l]..problem.offsets[l + 1]];
    if (0..segments.len()).all(|l| problem.families[l].sound(part(l))) {
        segments.iter_mut().enumerate().for_each(|(l, s)| *s = to_exponentials(part(l)));
    }
}
