//! A compressed field.
//!
//! A picture is, on the field's [`Domain`], the sum of its layers with weights that depend on the light alone. It is
//! linear light relative to that of the stack's lights: a directional light as strong as the stack's gives the stack's
//! pictures.

use crate::Domain;
use crate::basis::Basis;
use crate::sphere::Kernel;
use crate::texture::Texture;
use crate::tiles::{self, Tiles};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// How a field was made, and so what its layers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// Planes with weights in colour, found in a closed loop, cross-validated interpolation: the default.
    Layers,
    /// The thesis' eigenimages of log light.
    LogPca,
    /// The same of linear light.
    LinearPca,
    /// Polynomial texture maps.
    Ptm,
    /// Hemispherical harmonics of orders 0 to 2.
    Hsh,
    /// Planes of another program, as it left them.
    Imported,
}

/// Where a layer's weight for a direction comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum Angular {
    /// Weights at the stack's lights: a row a light.
    Lights {
        /// Whether weights have colour: then the columns are red, green and blue of a constant, then of each channel of each
        /// layer. Otherwise layers have three channels, which are the picture's, and there is a column for each layer.
        colour: bool,
        /// Unit directions.
        lights: Vec<[f32; 3]>,
        /// Unit directions to the camera, one for each light; none where all pictures have one view.
        views: Vec<[f32; 3]>,
        /// Lights × columns.
        table: DMatrix<f32>,
        /// What is between the lights.
        kernel: Kernel,
    },
    /// Functions of the direction, one a layer.
    Basis(Basis),
}

/// A compressed reflectance field.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// How it was made.
    pub model: Model,
    /// Width in texels.
    pub width: usize,
    /// Height in texels.
    pub height: usize,
    /// The scale of the sums.
    pub domain: Domain,
    /// Light that a value of 1 on a linear scale stands for.
    pub white: f32,
    /// The textures, all of the picture's size.
    pub layers: Vec<Texture>,
    /// Which parts of the picture have how many of the layers; blocks that a tile has not are 0 and do not count. `None`: all
    /// have all.
    pub tiles: Option<Tiles>,
    /// Weights by direction.
    pub angular: Angular,
}

/// What the layers are multiplied with for one light.
#[derive(Clone, Debug, PartialEq)]
pub struct Mix {
    /// Added everywhere, by channel.
    pub constant: [f32; 3],
    /// Weight by channel: of each plane if the weights have colour, else of each layer.
    pub layers: Vec<[f32; 3]>,
}

impl Field {
    /// Whether the weights have colour ([`Angular::Lights`]).
    pub fn in_colour(&self) -> bool {
        matches!(self.angular, Angular::Lights { colour: true, .. })
    }

    /// Planes of all textures.
    pub fn planes(&self) -> usize {
        self.layers.iter().map(|l| l.codec.channels()).sum()
    }

    /// Bytes of the textures, as far as they count.
    pub fn texture_bytes(&self) -> usize {
        match &self.tiles {
            Some(tiles) => tiles.bytes(&self.layers.iter().map(|l| l.codec).collect::<Vec<_>>()),
            None => self.layers.iter().map(|l| l.data.len()).sum(),
        }
    }

    /// The unit directions of the stack's lights, where the field knows them.
    pub fn lights(&self) -> &[[f32; 3]] {
        match &self.angular {
            Angular::Lights { lights, .. } => lights,
            Angular::Basis(_) => &[],
        }
    }

    /// The unit directions to the camera, one for each light, where pictures differ in that.
    pub fn views(&self) -> &[[f32; 3]] {
        match &self.angular {
            Angular::Lights { views, .. } => views,
            Angular::Basis(_) => &[],
        }
    }

    /// The part of the field in some of the rows of texels, which begin with a row of tiles and end with one or with the picture.
    pub(crate) fn rows(&self, rows: Range<usize>) -> Self {
        let cut = |l: &Texture| {
            let bytes = l.codec.bytes(self.width, rows.start)..l.codec.bytes(self.width, rows.end);
            Texture { data: l.data.get(bytes).unwrap_or_default().to_vec(), ..*l }
        };
        let part = |t: &Tiles| {
            let counts = rows.start / tiles::SIDE * t.across..rows.end.div_ceil(tiles::SIDE) * t.across;
            Tiles { across: t.across, counts: t.counts.get(counts).unwrap_or_default().to_vec() }
        };
        Self {
            model: self.model,
            width: self.width,
            height: rows.len(),
            domain: self.domain,
            white: self.white,
            layers: self.layers.iter().map(cut).collect(),
            tiles: self.tiles.as_ref().map(part),
            angular: self.angular.clone(),
        }
    }

    pub(crate) fn mix(&self, columns: &[f32]) -> Mix {
        if self.in_colour() {
            let mut triples = columns.chunks_exact(3).map(|c| [c[0], c[1], c[2]]);
            return Mix { constant: triples.next().unwrap_or_default(), layers: triples.collect() };
        }
        Mix { constant: [0.0; 3], layers: columns.iter().map(|w| [*w; 3]).collect() }
    }

    /// The weights of light `i` of the stack, as they were found, without interpolation.
    pub fn mix_of_light(&self, i: usize) -> Option<Mix> {
        match &self.angular {
            Angular::Lights { table, .. } if i < table.nrows() => {
                Some(self.mix(&table.row(i).iter().copied().collect::<Vec<_>>()))
            }
            _ => None,
        }
    }
}
