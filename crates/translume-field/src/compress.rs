//! From a stack to a field: the phases of [Menzel 2012, §4], for the default model and its baselines.

use crate::Relighter;
use crate::basis::Basis;
use crate::field::{Angular, Field, Model};
use crate::file;
use crate::layers::{self, Plan};
use crate::matrix::{self, Matrix};
use crate::memory::{Demand, Limits, Shares};
use crate::pca;
use crate::planes::Planes;
use crate::sphere::{Kernel, points};
use crate::stack::Stack;
use crate::texture::{Codec, Texture};
use crate::tiles::{self, Tiles, Tiling};
use crate::{Domain, Error, Result};
use nalgebra::DMatrix;
use rayon::prelude::*;
use std::path::PathBuf;

/// Most layers of a field.
pub const MOST_TERMS: usize = 128;
/// Pictures for whose dense system there is time: every opening of the field solves it again.
const MOST_NODES: usize = 4096;
/// Texels that are enough to find principal directions from.
const ENOUGH: usize = 1 << 17;

/// Layers of 4 bits a texel that one of 16 bits takes the place of.
const RESIDUAL_LAYERS: usize = 4;

/// Memory for principal planes beside the stack, by which their number is chosen.
const BESIDE: usize = 256 << 20;

/// How to compress.
#[derive(Clone, Debug, PartialEq)]
pub struct Params {
    /// What to make.
    pub model: Model,
    /// How many layers; PTM and HSH have their own number.
    pub rate: Rate,
    /// Scale; `None` for that of the model.
    pub domain: Option<Domain>,
    /// Storage of a layer; `None` for that of the model.
    pub codec: Option<Codec>,
    /// Interpolation by the thesis' Gaussian instead of by cross-validation; `None`: as the model has it.
    pub gaussian: Option<bool>,
    /// Principal directions by a randomised range finder instead of by Lanczos iteration, in the PCA models.
    pub randomised: bool,
    /// Whether a layer of the default model sees what encoding the earlier ones lost; otherwise for comparison.
    pub closed_loop: bool,
    /// How the layers of the default model are given to the parts of the picture.
    pub tiling: Tiling,
    /// What an error of colour counts beside one of luminance, in the default model; 1: the same.
    pub chroma: f32,
    /// How many planes of 16 bits the default model has for what its other layers leave. Each takes the place of four of those; there
    /// are no tiles then.
    pub residual: usize,
    /// Most pictures between which is interpolated; of more, all shape the layers, and an even choice keeps its weights.
    pub nodes: usize,
    /// Bytes of memory that all may take: stacks larger than three quarters of it are read twice, and planes that find no room go
    /// to files.
    pub memory: usize,
    /// Folder for those files, which have no names and end with the process; `None`: the system's for temporary files.
    pub scratch: Option<PathBuf>,
}

/// What decides the number of layers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// 16, or as many as the stack gives.
    Default,
    /// So many.
    Terms(usize),
    /// As many as fit into a file of so many bytes.
    Bytes(usize),
    /// The fewest with which the pictures of the stack reach this PSNR in dB as [`crate::measure`] has it.
    Psnr(f64),
}

impl Default for Params {
    fn default() -> Self {
        Self {
            model: Model::Layers,
            rate: Rate::Default,
            domain: None,
            codec: None,
            gaussian: None,
            randomised: false,
            closed_loop: true,
            tiling: Tiling::Auto,
            chroma: 1.0,
            residual: 0,
            nodes: MOST_NODES,
            memory: 2048 << 20,
            scratch: None,
        }
    }
}

impl Params {
    /// The scale that will be used.
    pub fn domain(&self) -> Domain {
        self.domain.unwrap_or(match self.model {
            Model::LogPca => Domain::THESIS,
            Model::LinearPca => Domain::Linear,
            Model::Ptm | Model::Hsh | Model::Imported => Domain::Display,
            Model::Layers => Domain::default(),
        })
    }

    /// The storage that will be used; of several, that which serves a layer best.
    pub fn codecs(&self) -> Vec<Codec> {
        match (self.codec, self.model) {
            (Some(codec), _) => vec![codec],
            (None, Model::Layers) => vec![Codec::Bc4, Codec::Bc1],
            (None, Model::LogPca | Model::LinearPca) => vec![Codec::Bc1],
            (None, Model::Ptm | Model::Hsh | Model::Imported) => vec![Codec::Rgb8],
        }
    }

    /// Most terms that a stack of `lights` pictures gives.
    fn most(&self, lights: usize) -> usize {
        if self.model == Model::Layers { MOST_TERMS.min(3 * lights) } else { MOST_TERMS.min(lights) }
    }

    /// Whether the picture is large enough for tiles to differ, and all is as they need it.
    fn may_tile(&self, stack: &Stack) -> bool {
        let (across, down) = Tiles::grid(stack.width, stack.height);
        let blocks = self.codecs().iter().all(|c| matches!(c, Codec::Bc1 | Codec::Bc4));
        across * down >= 16 && blocks && self.closed_loop && self.residual == 0
    }

    /// The number of terms, where the pictures need not be looked at.
    fn terms(&self, stack: &Stack) -> Result<Option<usize>> {
        let lights = stack.shots.len();
        let most = self.most(lights);
        match self.rate {
            Rate::Default => Ok(Some(most.min(16))),
            Rate::Terms(0) => Err(Error::Parameter("no terms: at least one is needed".into())),
            Rate::Terms(k) if k > most => {
                Err(Error::Parameter(format!("{k} terms: {lights} pictures give at most {most} in this model")))
            }
            Rate::Terms(k) => Ok(Some(k)),
            Rate::Bytes(bytes) => {
                // Texture, weights, and what the description says of a layer; generously, so that the file is never larger.
                let term = self.codecs()[0].bytes(stack.width, stack.height) + 18 * lights + 800;
                let k = bytes.saturating_sub(3000 + 24 * lights) / term;
                if k == 0 {
                    return Err(Error::Parameter(format!(
                        "{bytes} bytes hold no layer: one takes about {term}, and the rest {}",
                        3000 + 24 * lights
                    )));
                }
                Ok(Some(k.min(most)))
            }
            Rate::Psnr(_) => Ok(None),
        }
    }
}

/// Compresses `stack`. `progress` is called with the phase, once a picture while reading.
///
/// # Errors
/// Of reading the stack; [`Error::Parameter`] for parameters that the stack does not allow.
pub fn compress(stack: &mut Stack, params: &Params, progress: &(dyn Fn(&str) + Sync)) -> Result<Field> {
    let domain = params.domain().check()?;
    let terms = params.terms(stack)?;
    if !(params.chroma > 0.0 && params.chroma.is_finite()) {
        return Err(Error::Parameter(format!("a weight of {} for colour: it must be positive", params.chroma)));
    }
    if params.residual > 0 && !matches!(params.rate, Rate::Default | Rate::Terms(_)) {
        return Err(Error::Parameter("planes of 16 bits go with a number of terms".into()));
    }
    if terms.is_some_and(|terms| terms <= RESIDUAL_LAYERS * params.residual) {
        let what = format!(
            "{} planes of 16 bits: they need more than {} terms",
            params.residual,
            RESIDUAL_LAYERS * params.residual
        );
        return Err(Error::Parameter(what));
    }
    if params.model != Model::Layers && params.codecs().iter().any(|c| c.channels() != 3) {
        return Err(Error::Parameter("this model needs layers of three channels: bc1, bc6h, bc7 or rgb8".into()));
    }
    if params.nodes == 0 {
        return Err(Error::Parameter("no pictures to interpolate between: at least one is needed".into()));
    }
    let lights: Vec<[f32; 3]> = stack.shots.iter().map(|s| s.light).collect();
    let views = stack.views();
    if lights.len() > params.nodes && !matches!(params.model, Model::Ptm | Model::Hsh) {
        stack.warnings.push(format!(
            "{}: of {} pictures all shape the layers, but only {}, spread evenly, are interpolated between",
            stack.folder.display(),
            lights.len(),
            params.nodes
        ));
    }
    if matches!(params.model, Model::Ptm | Model::Hsh) && !views.is_empty() {
        return Err(Error::Parameter(
            "PTM and HSH are functions of the light: pictures from several views need another model".into(),
        ));
    }
    let basis = match params.model {
        Model::Ptm => Some(Basis::Ptm),
        Model::Hsh => Some(Basis::Hsh),
        Model::Imported => return Err(Error::Parameter("a stack is not imported".into())),
        _ => None,
    };
    if let Some(basis) = basis.filter(|b| b.fit(&lights).is_none()) {
        let what = format!("{} lights do not determine the {} terms of {basis:?}", lights.len(), basis.terms());
        return Err(Error::Parameter(what));
    }
    // How many layers a PSNR takes is not known before; what they take is looked at when it is.
    let demand = demand(stack, params, terms.unwrap_or(1), basis);
    let limits = Limits {
        memory: params.memory,
        folder: params.scratch.clone().unwrap_or_else(std::env::temp_dir),
        codec: params.codecs().into_iter().max_by_key(|c| c.bytes(4, 4)).unwrap_or(Codec::Rgb8),
        keeps_matrix: matches!(params.rate, Rate::Psnr(_)),
    };
    let shares = Shares::new(stack, limits, demand)?;
    stack.reading = shares.reading;
    let matrix = Matrix::read(stack, domain, shares.stack, &|| progress("reading"))?;
    let mut job = Job { stack, params, domain, matrix, shares, lights, views, progress };
    let mut field = match (basis, terms) {
        (Some(basis), _) => job.polynomial(basis)?,
        (None, Some(terms)) => job.field_of(terms)?,
        (None, None) => job.search()?,
    };
    file::quantise_weights(&mut field);
    Ok(field)
}

/// What `terms` layers, or the terms of `basis`, take.
fn demand(stack: &Stack, params: &Params, terms: usize, basis: Option<Basis>) -> Demand {
    if params.model != Model::Layers {
        let textures = basis.map_or(terms, Basis::terms);
        return Demand { textures, residual: 0, inputs: 3 * textures, decoded: 0 };
    }
    let coarse = terms - RESIDUAL_LAYERS * params.residual;
    // Some tiles may have more layers.
    let tiled = params.may_tile(stack) && params.tiling != Tiling::Whole;
    let textures = if tiled { (2 * coarse).min(params.most(stack.shots.len())) } else { coarse };
    let decoded = layers::planes_of(&params.codecs(), textures) + params.residual;
    let inputs = (layers::planes_of(&params.codecs(), terms) + 8).min(3 * stack.shots.len());
    Demand { textures, residual: params.residual, inputs, decoded }
}

/// What a trial says: what is left in all, and layers by tile, unless all have all.
struct Given {
    left: f64,
    counts: Option<Vec<u8>>,
}

struct Job<'a> {
    stack: &'a mut Stack,
    params: &'a Params,
    domain: Domain,
    matrix: Matrix,
    shares: Shares,
    lights: Vec<[f32; 3]>,
    views: Vec<[f32; 3]>,
    progress: &'a (dyn Fn(&str) + Sync),
}

impl Job<'_> {
    /// Every so many pieces of the matrix are enough for statistics.
    fn step(&self) -> usize {
        (self.matrix.texels / ENOUGH).max(1)
    }

    /// Planes of all pixels; the matrix is given back where nothing needs it any more.
    fn project(&mut self, projection: &DMatrix<f32>, offset: &[f32], demand: Demand) -> Result<Planes> {
        let (progress, kept) = (self.progress, matches!(self.params.rate, Rate::Psnr(_)));
        if !kept && !self.matrix.is_whole() {
            self.matrix.release();
        }
        let matrix = self.matrix.bytes();
        let reading = if self.matrix.is_whole() { 0 } else { self.stack.bytes_to_read() };
        let demand = Demand { inputs: projection.ncols(), ..demand };
        let mut planes = self.shares.planes(self.stack, demand, matrix + reading, if kept { matrix } else { 0 })?;
        self.matrix.project(self.stack, self.domain, projection, offset, &mut planes, &|| progress("reading"))?;
        if !kept {
            self.matrix.release();
        }
        Ok(planes)
    }

    fn field_of(&mut self, terms: usize) -> Result<Field> {
        if self.params.model == Model::Layers { self.layers(terms) } else { self.eigenimages(terms) }
    }

    /// The fewest terms with the PSNR asked for.
    fn search(&mut self) -> Result<Field> {
        let Rate::Psnr(wanted) = self.params.rate else { return self.field_of(16) };
        let most = self.params.most(self.lights.len());
        let (mut too_few, mut enough) = (0, 1);
        let mut best = loop {
            let field = self.field_of(enough)?;
            let got = self.psnr(&field)?;
            if got >= wanted {
                break field;
            }
            if enough == most {
                let what = format!("{wanted} dB are out of reach: {most} layers give {got:.2} dB");
                return Err(Error::Parameter(what));
            }
            too_few = enough;
            enough = (2 * enough).min(most);
        };
        while enough - too_few > 1 {
            let middle = usize::midpoint(too_few, enough);
            let field = self.field_of(middle)?;
            if self.psnr(&field)? >= wanted {
                (enough, best) = (middle, field);
            } else {
                too_few = middle;
            }
        }
        Ok(best)
    }

    /// Of the texels held and up to 64 lights, after tone mapping.
    fn psnr(&self, field: &Field) -> Result<f64> {
        let nodes = self.nodes();
        let n = nodes.len();
        let picked: Vec<usize> = (0..n.min(64)).map(|i| i * n / n.min(64)).collect();
        // All of a large field decoded would take more memory than its layers do.
        const LARGE: usize = 1 << 22;
        let large = self.stack.pixels() > LARGE;
        let relighter = if large { None } else { Some(Relighter::without_directions(field)?) };
        let mut picture = vec![0.0; 3 * self.stack.pixels()];
        let mut mse = 0.0;
        for &i in &picked {
            let Some(mix) = field.mix_of_light(i) else { continue };
            picture.fill(0.0);
            match &relighter {
                Some(relighter) => relighter.add_picture(&mix, [1.0; 3], &mut picture),
                None => Relighter::by_rows(field, &mix, &mut |above, light| {
                    picture[3 * above * field.width..][..light.len()].copy_from_slice(light);
                })?,
            }
            mse += self.matrix.display_error(nodes[i], &picture, field.white, self.domain) / picked.len() as f64;
        }
        Ok(-10.0 * mse.max(1e-20).log10())
    }

    fn field(&self, layers: Vec<Texture>, angular: Angular) -> Field {
        Field {
            model: self.params.model,
            width: self.stack.width,
            height: self.stack.height,
            domain: self.domain,
            white: self.stack.white,
            layers,
            tiles: None,
            angular,
        }
    }

    /// The pictures between which is interpolated: all, or [`Params::nodes`] of more.
    fn nodes(&self) -> Vec<usize> {
        let (n, most) = (self.lights.len(), self.lights.len().min(self.params.nodes));
        (0..most).map(|i| i * n / most).collect()
    }

    /// Weights by direction: those of the nodes, `table` and `factors` having a row for every picture.
    fn angular(&self, colour: bool, gaussian: bool, table: &DMatrix<f32>, factors: &DMatrix<f64>) -> Angular {
        let nodes = self.nodes();
        let of = |all: &[[f32; 3]]| -> Vec<[f32; 3]> { nodes.iter().filter_map(|i| all.get(*i).copied()).collect() };
        let (lights, views) = (of(&self.lights), of(&self.views));
        let points = points(&lights, &views);
        let kernel = if self.params.gaussian.unwrap_or(gaussian) {
            Kernel::gaussian(&points)
        } else {
            Kernel::cross_validated(&points, &factors.select_rows(&nodes), self.domain)
        };
        Angular::Lights { colour, table: table.select_rows(&nodes), lights, views, kernel }
    }

    /// The default: principal directions of texels in the space of lights and colours, then layers in a closed loop.
    fn layers(&mut self, terms: usize) -> Result<Field> {
        (self.progress)("decomposing");
        let step = self.step();
        let means = self.origin(step);
        let codecs = self.params.codecs();
        let channels = codecs.iter().map(|c| c.channels()).max().unwrap_or(1);
        let planes = self.principal_planes(terms, channels);
        let (directions, _) = pca::randomised(&self.matrix, &means, planes, 1, step);
        let offset: Vec<f32> =
            directions.tr_mul(&nalgebra::DVector::from_column_slice(&means)).iter().copied().collect();
        let mut planes = self.project(&directions, &offset, demand(self.stack, self.params, terms, None))?;
        (self.progress)("encoding");
        let size = (self.stack.width, self.stack.height);
        let metric = self.metric(&directions)?;
        if let Some(root) = &metric {
            transform(&mut planes, &root.map(|v| v as f32))?;
        }
        let coarse = terms - RESIDUAL_LAYERS * self.params.residual;
        let (codecs, tiles) = self.plan(&planes, &codecs, coarse)?;
        let count = tiles.as_ref().map_or(coarse, Tiles::most);
        let Params { residual, closed_loop, .. } = *self.params;
        let plan = Plan { count, residual, closed_loop, tiles: tiles.as_ref() };
        let mut found = layers::encode(planes, size, &codecs, &plan, &mut |_| Ok(()))?;
        if let Some(inverse) = metric.and_then(|root| root.try_inverse()) {
            found.weights *= inverse;
        }
        // Back from principal coordinates to lights and channels: (1 + layers) × (3 lights).
        let mut columns = found.weights.map(|w| w as f32) * directions.transpose();
        means.iter().enumerate().for_each(|(i, m)| columns[(0, i)] += m);
        let k = columns.nrows();
        let table = DMatrix::from_fn(self.lights.len(), 3 * k, |l, j| columns[(j / 3, 3 * l + j % 3)]);
        (self.progress)("interpolating");
        // With H = LLᵀ the products of the layers, rows of this times L are the pictures up to a rotation.
        let root = psd_root(&found.products);
        let factors = DMatrix::from_fn(self.lights.len(), 3 * k, |l, j| {
            (0..k).map(|i| f64::from(table[(l, 3 * i + j % 3)]) * root[(i, j / 3)]).sum()
        });
        let angular = self.angular(true, false, &table, &factors);
        Ok(Field { tiles, ..self.field(found.textures, angular) })
    }

    /// How many principal planes are found for `terms` layers: as many as those hold, and a few; for tiles, some of which have more
    /// layers, up to twice as many, as memory allows.
    fn principal_planes(&self, terms: usize, channels: usize) -> usize {
        let needed = terms * channels + 8;
        if !self.may_tile() || self.params.tiling == Tiling::Whole {
            return needed;
        }
        let room = (self.shares.stack + BESIDE).saturating_sub(self.matrix.bytes());
        (room / (4 * self.stack.pixels())).clamp(needed, 2 * terms * channels + 8)
    }

    /// What planes are counted from: the means of the columns; no light, where a good part of the picture is black under all
    /// lights, so that tiles there need no layer.
    fn origin(&self, step: usize) -> Vec<f32> {
        const MUCH: f64 = 0.02;
        if self.may_tile()
            && self.params.tiling != Tiling::Whole
            && self.matrix.share_of(self.domain.value(0.0), step) > MUCH
        {
            return vec![self.domain.value(0.0); 3 * self.lights.len()];
        }
        self.matrix.means(step)
    }

    fn may_tile(&self) -> bool {
        self.params.may_tile(self.stack)
    }

    /// What makes errors of colour weigh less, in principal coordinates: the lower root L of the metric, so that e L has the length that
    /// e is to count. `None`: all count the same.
    fn metric(&self, directions: &DMatrix<f32>) -> Result<Option<DMatrix<f64>>> {
        let chroma = f64::from(self.params.chroma);
        if chroma == 1.0 {
            return Ok(None);
        }
        // By light: y yᵀ + w² (1 − y yᵀ), y the grey axis.
        let (n, k) = (directions.nrows() / 3, directions.ncols());
        let along = DMatrix::from_fn(n, k, |l, j| {
            (0..3).map(|c| f64::from(directions[(3 * l + c, j)])).sum::<f64>() / 3f64.sqrt()
        });
        let all = directions.map(f64::from);
        let grey = along.transpose() * &along;
        let metric = all.transpose() * all * chroma.powi(2) + grey * (1.0 - chroma.powi(2));
        let root = nalgebra::Cholesky::new(metric).map(|c| c.l());
        root.map(Some).ok_or_else(|| Error::Parameter(format!("a weight of {chroma} for colour: it is too small")))
    }

    /// Which codecs to encode with, and how many layers each tile gets (`None`: all have all), for the bytes of `terms` layers everywhere:
    /// whatever leaves least in a trial on a part of the picture.
    fn plan(&self, planes: &Planes, codecs: &[Codec], terms: usize) -> Result<(Vec<Codec>, Option<Tiles>)> {
        let size = (self.stack.width, self.stack.height);
        if !self.may_tile() || self.params.tiling == Tiling::Whole {
            return Ok((layers::best_codecs(planes, size, codecs, terms, self.params.closed_loop)?, None));
        }
        let mut best = (f64::INFINITY, codecs.to_vec());
        let choices = layers::choices(codecs);
        for choice in choices.iter().filter(|_| choices.len() > 1) {
            let left = layers::left_in_tiles(planes, size, choice, self.most_in_a_tile(terms), layers::ENOUGH)?;
            let given = self.give(&left, choice, terms);
            if given.left < best.0 {
                best = (given.left, choice.clone());
            }
        }
        let codecs = best.1;
        let left = layers::left_in_tiles(planes, size, &codecs, self.most_in_a_tile(terms), layers::ENOUGH_FOR_TILES)?;
        let given = self.give(&left, &codecs, terms);
        let (across, _) = Tiles::grid(size.0, size.1);
        Ok((codecs, given.counts.map(|counts| Tiles { across, counts })))
    }

    /// Most layers of a tile, for the bytes of `terms` layers everywhere.
    fn most_in_a_tile(&self, terms: usize) -> usize {
        (2 * terms).min(self.params.most(self.lights.len()))
    }

    /// Gives layers to the tiles, of which `left` says what they would leave with 0, 1, … of them.
    fn give(&self, left: &[Vec<f64>], codecs: &[Codec], terms: usize) -> Given {
        // What a trial must leave less of, for a file that is less simple.
        const WORTH: f64 = 0.95;
        let size = (self.stack.width, self.stack.height);
        let most = self.most_in_a_tile(terms);
        let mut bytes = terms * codecs[0].bytes(size.0, size.1);
        if let Rate::Bytes(_) = self.params.rate {
            // The bytes of the weights of more layers, and of rows of tiles that are not full.
            bytes = bytes.saturating_sub((most - terms) * (18 * self.lights.len() + 800) + 128 * 512);
        }
        let budget = bytes.saturating_sub(left[0].len()) / codecs[0].bytes(tiles::SIDE, tiles::SIDE);
        let counts = match self.params.tiling {
            Tiling::Mask => {
                let floor = 1e-9 * left[0].iter().sum::<f64>() / left[0].len() as f64;
                let lit = left[0].iter().filter(|e| **e > floor).count().max(1);
                let each = (budget / lit).min(most).min(left.len() - 1) as u8;
                left[0].iter().map(|e| if *e > floor { each } else { 0 }).collect()
            }
            _ => tiles::choose(left, budget),
        };
        let sum =
            |of: &dyn Fn(usize) -> usize| (0..counts.len()).map(|t| left[of(t).min(left.len() - 1)][t]).sum::<f64>();
        let (with, without) = (sum(&|t| usize::from(counts[t])), sum(&|_| terms));
        let wanted = with < WORTH * without || self.params.tiling != Tiling::Auto;
        if wanted && counts.iter().any(|c| *c > 0) {
            Given { left: with, counts: Some(counts) }
        } else {
            Given { left: without, counts: None }
        }
    }

    /// Eigenimages of three channels, σ u, and weights v [Menzel 2012, §4.2 components].
    fn eigenimages(&mut self, terms: usize) -> Result<Field> {
        (self.progress)("decomposing");
        let n = self.lights.len();
        // Of very many lights the products of all with each other are not summed.
        let vectors = if self.params.randomised || n > self.params.nodes {
            pca::randomised_lights(&self.matrix, terms, 2, 1)
        } else {
            let (gram, white) = pca::light_gram(&self.matrix, 1);
            pca::lanczos(&gram, &white, terms).0
        };
        let terms = vectors.ncols();
        let table = vectors.map(|v| v as f32);
        let projection =
            DMatrix::from_fn(
                3 * n,
                3 * terms,
                |row, out| if row % 3 == out % 3 { table[(row / 3, out / 3)] } else { 0.0 },
            );
        let planes = self.project(&projection, &vec![0.0; 3 * terms], demand(self.stack, self.params, terms, None))?;
        (self.progress)("encoding");
        let (mut energies, mut buffer) = (vec![0.0; terms], Vec::new());
        for plane in 0..planes.count() {
            for band in planes.bands(1, 1) {
                let values = planes.read(plane..plane + 1, band, &mut buffer)?;
                values.iter().for_each(|v| energies[plane / 3] += f64::from(v * v));
            }
        }
        let products = DMatrix::from_diagonal(&nalgebra::DVector::from_vec(energies));
        let layers = self.textures(&planes)?;
        (self.progress)("interpolating");
        let factors = vectors * products.map(f64::sqrt);
        let angular = self.angular(false, true, &table, &factors);
        Ok(self.field(layers, angular))
    }

    /// Coefficient planes of a fixed basis.
    fn polynomial(&mut self, basis: Basis) -> Result<Field> {
        let fit = basis.fit(&self.lights).unwrap_or_else(|| DMatrix::zeros(basis.terms(), self.lights.len()));
        let (n, terms) = (self.lights.len(), basis.terms());
        let projection =
            DMatrix::from_fn(
                3 * n,
                3 * terms,
                |row, out| if row % 3 == out % 3 { fit[(out / 3, row / 3)] as f32 } else { 0.0 },
            );
        let demand = demand(self.stack, self.params, terms, Some(basis));
        let planes = self.project(&projection, &vec![0.0; 3 * terms], demand)?;
        (self.progress)("encoding");
        let layers = self.textures(&planes)?;
        Ok(self.field(layers, Angular::Basis(basis)))
    }

    fn textures(&self, planes: &Planes) -> Result<Vec<Texture>> {
        let (codec, width) = (self.params.codecs()[0], self.stack.width);
        let texture =
            |first: usize| layers::encode_planes(codec, (planes, first), width, &|_, _| true, &mut |_, _| Ok(()));
        (0..planes.count()).step_by(3).map(texture).collect()
    }
}

/// Multiplies the rows (a texel, a value of each plane) by a square matrix.
fn transform(planes: &mut Planes, by: &DMatrix<f32>) -> Result<()> {
    let (n, mut buffer) = (planes.count(), Vec::new());
    for band in planes.bands(matrix::PIECE, n) {
        planes.edit(band.clone(), &mut buffer, |values| {
            matrix::pieces_of(values, band.len(), n).into_par_iter().for_each(|mut piece| {
                let rows = DMatrix::from_fn(piece[0].len(), n, |i, j| piece[j][i]);
                let product = rows * by;
                piece.iter_mut().zip(product.column_iter()).for_each(|(p, c)| p.copy_from_slice(c.as_slice()));
            });
            Ok(())
        })?;
    }
    Ok(())
}

/// L with LLᵀ = `matrix`, which is positive semi-definite up to rounding.
fn psd_root(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let (vectors, values) = pca::eigen(matrix);
    vectors * DMatrix::from_diagonal(&nalgebra::DVector::from_vec(values).map(f64::sqrt))
}
