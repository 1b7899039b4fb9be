//! The colour map "magma" (van der Walt and Smith, CC0), in which FLIP maps are shown.

/// Sixteen equidistant colours of the map; between them it is straight to within 3 of 255.
const COLOURS: [[u8; 3]; 16] = [
    [0, 0, 4],
    [11, 9, 36],
    [32, 17, 75],
    [59, 15, 112],
    [87, 21, 126],
    [114, 31, 129],
    [140, 41, 129],
    [168, 50, 125],
    [196, 60, 117],
    [222, 73, 104],
    [241, 96, 93],
    [250, 127, 94],
    [254, 159, 109],
    [254, 191, 132],
    [253, 222, 160],
    [252, 253, 191],
];

/// The sRGB colour of a value in [0, 1]; others are clipped, NaN is 0.
pub fn magma(value: f32) -> [u8; 3] {
    let position = if value > 0.0 { (value * 15.0).min(15.0) } else { 0.0 };
    let i = (position as usize).min(14);
    let f = position - i as f32;
    std::array::from_fn(|c| {
        let (a, b) = (f32::from(COLOURS[i][c]), f32::from(COLOURS[i + 1][c]));
        (a + f * (b - a)).round() as u8
    })
}
