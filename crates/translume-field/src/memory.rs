//! How the memory that compressing may take is shared out: pictures being read, the matrix of the stack, textures, and planes, which
//! go to files where they find no room.

use crate::layers;
use crate::matrix::PIECE;
use crate::planes::{Planes, Room};
use crate::stack::Stack;
use crate::texture::Codec;
use crate::tiles;
use crate::{Error, Result};

/// The program itself, its threads, and what is small.
const PROGRAM: usize = 96 << 20;
/// Bytes for each light, channel and plane projected to: sums while directions are found, and tables of weights.
const PER_WEIGHT: usize = 48;
/// Planes that are worked on at once beside those that are taken apart.
const AT_ONCE: usize = 16;

/// What a number of textures takes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Demand {
    /// Textures, and what is stored of them in R16 in the end.
    pub(crate) textures: usize,
    pub(crate) residual: usize,
    /// Planes that are projected to.
    pub(crate) inputs: usize,
    /// Planes that the textures decode to, as far as they are kept.
    pub(crate) decoded: usize,
}

/// How much memory there is, and what else decides the shares.
#[derive(Debug)]
pub(crate) struct Limits {
    /// Bytes of memory for all.
    pub(crate) memory: usize,
    /// Folder for what finds no room.
    pub(crate) folder: std::path::PathBuf,
    /// The largest codec of the layers.
    pub(crate) codec: Codec,
    /// The matrix is kept while textures are made.
    pub(crate) keeps_matrix: bool,
}

/// Shares of the memory.
#[derive(Debug)]
pub(crate) struct Shares {
    all: usize,
    /// The program, and what goes by the number of lights.
    base: usize,
    folder: std::path::PathBuf,
    size: (usize, usize),
    codec: Codec,
    /// For the matrix of the stack.
    pub(crate) stack: usize,
    /// For pictures that are read at the same time.
    pub(crate) reading: usize,
}

impl Shares {
    /// For `stack`, if all of `demand` finds room beside each other.
    ///
    /// # Errors
    /// [`Error::Parameter`] where the memory is not enough, with what is.
    pub(crate) fn new(stack: &Stack, limits: Limits, demand: Demand) -> Result<Self> {
        let Limits { memory, folder, codec, keeps_matrix } = limits;
        let mut shares = Self {
            all: memory,
            base: PROGRAM + PER_WEIGHT * 3 * stack.shots.len() * demand.inputs,
            folder,
            size: (stack.width, stack.height),
            codec,
            stack: 0,
            reading: 0,
        };
        let whole = 6 * stack.shots.len() * stack.pixels();
        // A few thousand texels, or all.
        let sample = whole.min(6 * stack.shots.len() * 16 * PIECE);
        let picture = stack.bytes_to_read();
        let encoding = shares.textures(demand) + shares.band(demand.inputs);
        let least = match keeps_matrix {
            true => shares.base + sample + picture.max(encoding + 12 * stack.pixels()),
            false => shares.base + encoding.max(sample + picture),
        };
        if memory < least {
            return Err(shares.too_little(&stack.folder, least));
        }
        // Planes get a quarter at least, so that they stay in memory where that is easy.
        let beside = if keeps_matrix { least - sample } else { shares.base + picture };
        shares.stack = memory - beside.max(memory / 4).min(memory - sample);
        shares.reading = memory - shares.base - shares.stack.min(whole);
        Ok(shares)
    }

    fn too_little(&self, folder: &std::path::Path, least: usize) -> Error {
        let mib = |n: usize| n.div_ceil(1 << 20);
        Error::Parameter(format!(
            "{}: {} MiB of memory are too little for pictures of {} × {}: at least {} are needed",
            folder.display(),
            self.all >> 20,
            self.size.0,
            self.size.1,
            mib(least)
        ))
    }

    /// Bytes of textures, and of two more that are tried.
    fn textures(&self, demand: Demand) -> usize {
        let (w, h) = self.size;
        (demand.textures + 2) * self.codec.bytes(w, h) + demand.residual * Codec::R16.bytes(w, h)
    }

    /// Bytes of the lowest band of planes.
    fn band(&self, inputs: usize) -> usize {
        4 * tiles::SIDE * self.size.0 * (inputs + AT_ONCE)
    }

    /// Planes of the stack's size, none yet: in memory if there is room for all that `demand` says beside `held` bytes, and, while they
    /// are projected to, beside `projected` bytes.
    ///
    /// # Errors
    /// [`Error::Parameter`] where there is not even room for a band of them, with what would be enough; of temporary files.
    pub(crate) fn planes(&self, stack: &Stack, demand: Demand, projected: usize, held: usize) -> Result<Planes> {
        let taken = self.base + self.textures(demand) + held;
        let (left, texels) = (self.all.saturating_sub(taken), stack.pixels());
        if left < self.band(demand.inputs) {
            return Err(self.too_little(&stack.folder, taken + self.band(demand.inputs)));
        }
        let expected = demand.inputs + demand.decoded + layers::BESIDE;
        // Trials take every eighth row once more.
        let expected = expected + expected.div_ceil(tiles::SIDE / 4);
        let crowded = self.base + projected + 4 * texels * demand.inputs > self.all;
        Room::new(left, self.folder.clone()).planes(texels, if crowded { usize::MAX } else { expected })
    }
}
