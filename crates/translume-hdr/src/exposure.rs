//! One picture of a bracket: its codes, its relative exposure and the part of it that is picture.

use crate::Response;
use crate::decode::{CLIPPED, Decoder, Kind, NOISE_BINS, float_levels};
use translume_image::{Codes, Samples};

/// One picture of a bracket.
#[derive(Clone, Debug)]
pub struct Exposure {
    /// Name for messages (the file).
    pub name: String,
    /// The picture as stored.
    pub codes: Codes,
    /// Coverage in [0, 1], one value a pixel, where the file has it: transparent pixels show nothing.
    pub alpha: Option<Vec<f32>>,
    /// Relative exposure: seconds, or seconds · ISO / N².
    pub secs: f64,
}

/// An [`Exposure`] prepared for the pipeline.
pub(crate) struct Shot<'a> {
    pub(crate) name: &'a str,
    pub(crate) codes: &'a Codes,
    pub(crate) log_secs: f32,
    /// `true` where the pixel is border or transparent, not picture.
    pub(crate) border: Option<Vec<bool>>,
    /// What is clipped, and what lies beside it; `None` if nothing is.
    pub(crate) clips: Option<Vec<u8>>,
    pub(crate) decoder: Decoder,
}

impl Shot<'_> {
    pub(crate) fn width(&self) -> usize {
        self.codes.width
    }

    pub(crate) fn height(&self) -> usize {
        self.codes.height
    }

    /// Whether pixel `i` (row-major) belongs to the picture.
    #[inline]
    pub(crate) fn is_picture(&self, i: usize) -> bool {
        self.border.as_ref().is_none_or(|b| !b[i])
    }

    /// Row `y` as unit codes, interleaved RGB.
    pub(crate) fn unit_row(&self, y: usize, out: &mut [f32]) {
        let range = y * self.width() * 3..(y + 1) * self.width() * 3;
        match &self.codes.samples {
            Samples::U8(v) => out.iter_mut().zip(&v[range]).for_each(|(o, c)| *o = f32::from(*c) * (1.0 / 255.0)),
            Samples::U16(v) => out.iter_mut().zip(&v[range]).for_each(|(o, c)| *o = f32::from(*c) * (1.0 / 65535.0)),
            Samples::F32(v) => out.copy_from_slice(&v[range]),
        }
    }

    /// The response, of sources that have one.
    pub(crate) fn response(&self) -> Option<&Response> {
        match &self.decoder.kind {
            Kind::Curve { response, .. } => Some(response),
            Kind::Float { .. } => None,
        }
    }

    /// Sets the response, for sources that have one.
    pub(crate) fn set_response(&mut self, response: &Response) {
        if let Kind::Curve { response: r, .. } = &mut self.decoder.kind {
            r.clone_from(response);
        }
    }
}

/// The decoder of a picture before its response is known.
pub(crate) fn decoder_of(codes: &Codes, response: &Response) -> Decoder {
    let kind = match &codes.samples {
        Samples::U8(_) | Samples::U16(_) => Kind::Curve { response: response.clone(), clip: [CLIPPED; 3] },
        Samples::F32(v) => {
            let clip = float_levels(v);
            Kind::Float { clip, full: v.iter().copied().fold(f32::MIN_POSITIVE, f32::max) }
        }
    };
    let mut decoder = Decoder { kind, blur: [0.0; NOISE_BINS] };
    decoder.blur = blur(codes, &decoder);
    decoder
}

/// Two standard deviations of the green noise per bin of the encoded range, and a rounding step.
///
/// The median difference of neighbours is noise as long as half of a bin's pixels lie on nothing finer than that; a bin
/// without enough pixels takes the value of the bin below.
fn blur(codes: &Codes, decoder: &Decoder) -> [f32; NOISE_BINS] {
    let step = match codes.samples {
        Samples::U8(_) => 1.0 / 255.0,
        Samples::U16(_) | Samples::F32(_) => 0.25 / 255.0,
    };
    let mut differences: Vec<Vec<f32>> = vec![Vec::new(); NOISE_BINS];
    let pixels = codes.width * codes.height;
    let stride = (pixels / 100_000).max(1);
    for i in (0..pixels).step_by(stride).filter(|i| i % codes.width + 1 < codes.width) {
        let (a, b) = (decoder.encoded(codes.unit(3 * i + 1)), decoder.encoded(codes.unit(3 * i + 4)));
        let bin = ((0.5 * (a + b) * NOISE_BINS as f32) as usize).min(NOISE_BINS - 1);
        differences[bin].push((a - b).abs());
    }
    let mut last = 2.0 / 255.0;
    std::array::from_fn(|k| {
        let d = &mut differences[k];
        if d.len() >= 50 {
            let mid = d.len() / 2;
            let median = *d.select_nth_unstable_by(mid, f32::total_cmp).1;
            last = (2.0 * median / (0.6745 * std::f32::consts::SQRT_2)).min(0.03);
        }
        last + step
    })
}

/// Where a picture shows nothing: its border and its transparent pixels. `None` if it shows something everywhere.
pub(crate) fn hidden(e: &Exposure) -> Option<Vec<bool>> {
    let Some(alpha) = &e.alpha else { return find_border(&e.codes) };
    // Half-covered pixels are mixed with nothing; a veil over all of a picture is no mask.
    let full = alpha.iter().copied().fold(0.0f32, f32::max).min(1.0);
    let transparent = |a: &f32| a.is_nan() || *a < 0.99 * full || full <= 0.0;
    let mut hidden: Vec<bool> = alpha.iter().map(transparent).collect();
    if let Some(border) = find_border(&e.codes) {
        hidden.iter_mut().zip(border).for_each(|(h, b)| *h |= b);
    }
    hidden.contains(&true).then_some(hidden)
}

/// Border of one exact colour, as registered scans have it, that reaches in from the sides: `true` where border.
///
/// Only colours that no exposure produces by itself count: neither black, nor white, nor grey, nor a clipped hue that
/// covers less than a whole side. `None` if there is no such border.
pub(crate) fn find_border(codes: &Codes) -> Option<Vec<bool>> {
    let Samples::U8(v) = &codes.samples else { return None };
    let (w, h) = (codes.width, codes.height);
    let pixel = |i: usize| [v[3 * i], v[3 * i + 1], v[3 * i + 2]];
    let saturated = |p: [u8; 3]| p.iter().max().unwrap_or(&0) - p.iter().min().unwrap_or(&0) > 64;
    let sides: [Vec<usize>; 4] = [
        (0..w).collect(),
        ((h - 1) * w..h * w).collect(),
        (0..h).map(|y| y * w).collect(),
        (0..h).map(|y| y * w + w - 1).collect(),
    ];
    let colour = sides.iter().find_map(|side| {
        let c = pixel(side[side.len() / 2]);
        let share = side.iter().filter(|i| pixel(**i) == c).count() as f64 / side.len() as f64;
        (saturated(c) && share > 0.9).then_some(c)
    })?;
    let mut border = vec![false; w * h];
    let mut stack: Vec<usize> = sides.into_iter().flatten().filter(|i| pixel(*i) == colour).collect();
    while let Some(i) = stack.pop() {
        if border[i] || pixel(i) != colour {
            continue;
        }
        border[i] = true;
        let (x, y) = (i % w, i / w);
        if x > 0 {
            stack.push(i - 1);
        }
        if x + 1 < w {
            stack.push(i + 1);
        }
        if y > 0 {
            stack.push(i - w);
        }
        if y + 1 < h {
            stack.push(i + w);
        }
    }
    // The last ring next to the border is often a blend of both.
    let grown = (0..w * h).map(|i| {
        let (x, y) = (i % w, i / w);
        border[i]
            || (x > 0 && border[i - 1])
            || (x + 1 < w && border[i + 1])
            || (y > 0 && border[i - w])
            || (y + 1 < h && border[i + w])
    });
    Some(grown.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_image::Metadata;

    fn codes(w: usize, h: usize, f: impl Fn(usize, usize) -> [u8; 3]) -> Codes {
        let samples = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).flat_map(|(x, y)| f(x, y)).collect();
        Codes { width: w, height: h, samples: Samples::U8(samples), metadata: Metadata::default() }
    }

    #[test]
    fn blue_border_is_found_and_a_white_sky_is_not() {
        let framed = codes(20, 10, |x, y| if x < 3 || y > 7 { [0, 0, 255] } else { [90, (x * 9) as u8, 40] });
        let border = find_border(&framed).unwrap();
        assert!(border[5 * 20 + 2] && border[9 * 20 + 10] && border[5 * 20 + 3]);
        assert!(!border[5 * 20 + 5]);
        let sky = codes(20, 10, |_, y| if y < 4 { [255; 3] } else { [30, 40, 50] });
        assert!(find_border(&sky).is_none());
    }
}
