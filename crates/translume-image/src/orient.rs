//! Turning a picture upright by its EXIF/TIFF orientation.

/// The eight orientations of EXIF 2.3 §4.6.4 (tag 0x0112): where row 0 and column 0 of the stored picture lie in the
/// upright one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Orientation {
    /// 1: row 0 at the top, column 0 at the left.
    #[default]
    TopLeft = 1,
    /// 2: mirrored left to right.
    TopRight,
    /// 3: turned by 180°.
    BottomRight,
    /// 4: mirrored top to bottom.
    BottomLeft,
    /// 5: transposed.
    LeftTop,
    /// 6: to be turned by 90° clockwise.
    RightTop,
    /// 7: transposed about the other diagonal.
    RightBottom,
    /// 8: to be turned by 90° counter-clockwise.
    LeftBottom,
}

impl Orientation {
    /// The orientation of an EXIF value; anything but 1 to 8 leaves the picture as it is.
    pub fn from_exif(value: u32) -> Self {
        use Orientation::*;
        match value {
            2 => TopRight,
            3 => BottomRight,
            4 => BottomLeft,
            5 => LeftTop,
            6 => RightTop,
            7 => RightBottom,
            8 => LeftBottom,
            _ => TopLeft,
        }
    }

    /// The orientation that undoes this one.
    pub fn inverse(self) -> Self {
        match self {
            Self::RightTop => Self::LeftBottom,
            Self::LeftBottom => Self::RightTop,
            own => own,
        }
    }

    /// Whether width and height change places.
    pub fn swaps_axes(self) -> bool {
        self as u8 >= Self::LeftTop as u8
    }

    /// Where pixel (x, y) of the upright picture is stored in a `width × height` one.
    fn stored(self, (x, y): (usize, usize), (width, height): (usize, usize)) -> (usize, usize) {
        use Orientation::*;
        match self {
            TopLeft => (x, y),
            TopRight => (width - 1 - x, y),
            BottomRight => (width - 1 - x, height - 1 - y),
            BottomLeft => (x, height - 1 - y),
            LeftTop => (y, x),
            RightTop => (y, height - 1 - x),
            RightBottom => (width - 1 - y, height - 1 - x),
            LeftBottom => (width - 1 - y, x),
        }
    }

    /// Turns interleaved pixels of `channels` values upright; returns the new width and height with them.
    pub fn apply<T: Copy>(
        self,
        (width, height): (usize, usize),
        channels: usize,
        pixels: Vec<T>,
    ) -> (usize, usize, Vec<T>) {
        if self == Self::TopLeft {
            return (width, height, pixels);
        }
        let (w, h) = if self.swaps_axes() { (height, width) } else { (width, height) };
        let mut out = Vec::with_capacity(pixels.len());
        for y in 0..h {
            for x in 0..w {
                let (sx, sy) = self.stored((x, y), (width, height));
                let i = (sy * width + sx) * channels;
                out.extend_from_slice(&pixels[i..i + channels]);
            }
        }
        (w, h, out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_eight_values_give_the_upright_picture() {
        // The upright picture is
        //   a b c
        //   d e f
        // and these are the stored ones that the EXIF standard describes for it.
        let stored: [(u32, usize, &str); 8] = [
            (1, 3, "abcdef"),
            (2, 3, "cbafed"),
            (3, 3, "fedcba"),
            (4, 3, "defabc"),
            (5, 2, "adbecf"),
            (6, 2, "cfbead"),
            (7, 2, "fcebda"),
            (8, 2, "daebfc"),
        ];
        for (value, width, text) in stored {
            let pixels: Vec<u8> = text.bytes().flat_map(|b| [b, b]).collect();
            let upright: Vec<u8> = "abcdef".bytes().flat_map(|b| [b, b]).collect();
            let got = Orientation::from_exif(value).apply((width, 6 / width), 2, pixels);
            assert_eq!(got, (3, 2, upright.clone()), "orientation {value}");
            let (_, _, back) = Orientation::from_exif(value).inverse().apply((3, 2), 2, upright);
            assert_eq!(back, text.bytes().flat_map(|b| [b, b]).collect::<Vec<_>>(), "orientation {value} undone");
        }
    }
}
