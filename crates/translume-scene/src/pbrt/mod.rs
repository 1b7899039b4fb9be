//! pbrt-v4 scene files: the directives and the state they change. Materials, shapes and lights are beside this file.
//!
//! Read are cameras, films and filters, triangle meshes, PLY, spheres, disks, cylinders, instances, the analytic
//! materials, image and checkerboard textures, homogeneous media, and area, point, spot, distant and constant infinite
//! lights. Motion, image infinite lights (their equal-area maps), procedural textures, curves and measured materials are
//! refused, unless the scene is to be read leniently.

mod camera;
mod lexer;
mod light;
mod material;
mod parameters;
mod shape;

use crate::builder::Builder;
use crate::mitsuba::read_text;
use crate::scene::{Group, GroupId, Instance, LoadOptions, MaterialId, MediumId, Scene, TextureId};
use crate::{Error, Result, check};
use glam::{DAffine3, DMat4, DVec3};
use lexer::{Lexer, Place, Token};
use parameters::Parameters;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use translume_mesh::TriMesh;

/// Attributes, transforms and includes do not nest deeper; included files are not opened more often in all.
const DEEPEST: usize = 1000;
const MOST_FILES: usize = 10_000;
const MOST_INCLUDED: usize = 1 << 28;
const DEEPEST_INCLUDE: usize = 32;

/// Reads a scene file.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] with the line for damaged files; [`Error::Unsupported`] for what changes the picture
/// and is not known here, unless `options.lenient`.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene> {
    let mut loader = Loader::new(path, options);
    loader.open(path, None)?;
    loader.run()?;
    loader.film_and_camera()?;
    check::instances(&loader.builder.scene, path)?;
    Ok(loader.builder.finish())
}

/// What `AttributeBegin` saves.
#[derive(Clone)]
struct State {
    world_from_object: DAffine3,
    material: Option<MaterialId>,
    area_light: Option<std::rc::Rc<Parameters>>,
    reverse: bool,
    interior: Option<MediumId>,
    exterior: Option<MediumId>,
}

struct Loader {
    builder: Builder,
    folder: PathBuf,
    /// Files being read, the innermost last, with their real names.
    files: Vec<(Lexer, PathBuf)>,
    opened: usize,
    /// Bytes of them.
    read: usize,
    state: State,
    saved: Vec<State>,
    systems: HashMap<String, DAffine3>,
    materials: HashMap<String, MaterialId>,
    textures: HashMap<String, TextureId>,
    media: HashMap<String, MediumId>,
    groups: HashMap<String, GroupId>,
    /// The group between `ObjectBegin` and `ObjectEnd`.
    group: Option<(String, Group)>,
    ply: HashMap<PathBuf, Arc<TriMesh>>,
    settings: camera::Settings,
    told: HashSet<String>,
}

impl Loader {
    fn new(path: &Path, options: &LoadOptions) -> Self {
        Self {
            builder: Builder::new(path, options),
            folder: path.parent().unwrap_or(Path::new("")).to_owned(),
            files: Vec::new(),
            opened: 0,
            read: 0,
            state: State {
                world_from_object: DAffine3::IDENTITY,
                material: None,
                area_light: None,
                reverse: false,
                interior: None,
                exterior: None,
            },
            saved: Vec::new(),
            systems: HashMap::new(),
            materials: HashMap::new(),
            textures: HashMap::new(),
            media: HashMap::new(),
            groups: HashMap::new(),
            group: None,
            ply: HashMap::new(),
            settings: camera::Settings::default(),
            told: HashSet::new(),
        }
    }

    fn open(&mut self, path: &Path, from: Option<&Place>) -> Result<()> {
        let name = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if let Some(place) = from {
            if self.files.iter().any(|f| f.1 == name) {
                return Err(place.invalid(format!("{} includes itself", path.display())));
            }
            if self.files.len() >= DEEPEST_INCLUDE || self.opened >= MOST_FILES {
                return Err(place.unsupported("includes nest too deep or are too many"));
            }
        }
        self.opened += 1;
        let text = read_text(path).map_err(|e| match from {
            Some(place) => e.at(&place.file, place.line),
            None => e,
        })?;
        self.read += text.len();
        if from.is_some() && self.read > MOST_INCLUDED {
            return Err(Error::unsupported(
                path,
                None,
                format!("included files hold more than {} MiB", MOST_INCLUDED >> 20),
            ));
        }
        self.files.push((Lexer::new(path, text, from.is_none()), name));
        Ok(())
    }

    /// Reads directives until all files are at their ends.
    fn run(&mut self) -> Result<()> {
        let mut last = None;
        while let Some((lexer, _)) = self.files.last_mut() {
            let Some(token) = lexer.next()? else {
                last = self.files.pop().map(|f| f.0.place);
                continue;
            };
            let place = lexer.place.clone();
            let Token::Word(directive) = token else {
                return Err(place.invalid("a directive is missing"));
            };
            self.directive(&directive, place)?;
        }
        if let (Some(place), true) = (last, !self.saved.is_empty() || self.group.is_some()) {
            let what = "the file ends within AttributeBegin, TransformBegin or ObjectBegin: is it truncated?";
            return Err(place.invalid(what));
        }
        Ok(())
    }

    /// The file being read.
    fn lexer(&mut self) -> Result<&mut Lexer> {
        let path = self.builder.path.clone();
        self.files.last_mut().map(|f| &mut f.0).ok_or_else(|| Error::invalid(&path, None, "the file ends too early"))
    }

    fn directive(&mut self, name: &str, place: Place) -> Result<()> {
        match name {
            "Identity" | "Transform" | "ConcatTransform" | "Translate" | "Scale" | "Rotate" | "LookAt"
            | "CoordSysTransform" => self.transform(name, &place),
            "CoordinateSystem" => {
                let system = self.lexer()?.text("a name")?;
                self.systems.insert(system, self.state.world_from_object);
                Ok(())
            }
            "AttributeBegin" | "TransformBegin" | "AttributeEnd" | "TransformEnd" => self.scope(name, &place),
            "ReverseOrientation" => {
                self.state.reverse = !self.state.reverse;
                Ok(())
            }
            "WorldBegin" => {
                self.systems.insert("world".to_owned(), DAffine3::IDENTITY);
                self.state.world_from_object = DAffine3::IDENTITY;
                Ok(())
            }
            "Include" | "Import" => {
                let file = self.lexer()?.text("a file name")?;
                self.open(&self.folder.join(file), Some(&place))
            }
            "ObjectBegin" | "ObjectEnd" | "ObjectInstance" => self.object(name, &place),
            "MediumInterface" => self.medium_interface(&place),
            "NamedMaterial" => {
                let material = self.lexer()?.text("a name")?;
                let unknown = || place.invalid(format!("there is no material {material:?}"));
                self.state.material = Some(*self.materials.get(&material).ok_or_else(unknown)?);
                Ok(())
            }
            "ColorSpace" => {
                let space = self.lexer()?.text("a name")?;
                if space != "srgb" {
                    self.builder.warn(place.warning(format!("the colour space {space:?} is taken as \"srgb\"")));
                }
                Ok(())
            }
            "Texture" => self.texture(place),
            "ActiveTransform" | "TransformTimes" => {
                // Their arguments are words and numbers, and everything after would be wrong: no leniency.
                Err(place.unsupported(format!("{name} (motion) is not supported")))
            }
            _ => self.plugin(name, place),
        }
    }

    /// A directive of the form `Name "type" parameters`.
    fn plugin(&mut self, name: &str, place: Place) -> Result<()> {
        const KNOWN: [&str; 14] = [
            "Accelerator",
            "AreaLightSource",
            "Attribute",
            "Camera",
            "Film",
            "Integrator",
            "LightSource",
            "MakeNamedMaterial",
            "MakeNamedMedium",
            "Material",
            "Option",
            "PixelFilter",
            "Sampler",
            "Shape",
        ];
        if !KNOWN.contains(&name) {
            let quote = if self.lexer()?.quotes { name } else { "this" };
            return Err(place.unsupported(format!("{quote} is not a directive that is known")));
        }
        let lexer = self.lexer()?;
        if name == "Option" {
            lexer::parameters(lexer)?;
            return Ok(());
        }
        let kind = lexer.text("a type")?;
        let parameters = Parameters { list: lexer::parameters(lexer)?, place };
        let made = match name {
            "Integrator" | "Sampler" | "PixelFilter" | "Film" | "Camera" => self.setting(name, &kind, parameters),
            "MakeNamedMaterial" => self.named_material(&kind, &parameters),
            "Material" => self.material(&kind, "", &parameters).map(|id| self.state.material = Some(id)),
            "MakeNamedMedium" => self.named_medium(&kind, &parameters),
            "AreaLightSource" => {
                if kind != "diffuse" {
                    return Err(parameters.place.unsupported(format!("area light {kind:?} is not supported")));
                }
                self.state.area_light = Some(std::rc::Rc::new(parameters));
                Ok(())
            }
            "LightSource" => self.light(&kind, &parameters),
            "Shape" => self.shape(&kind, &parameters),
            "Attribute" => Err(parameters.place.unsupported("Attribute is not supported")),
            _ => Ok(()), // how rays are found is our own affair
        };
        self.skippable(made)
    }

    /// Passes an error on, or makes it a warning where the scene is read leniently.
    fn skippable(&mut self, made: Result<()>) -> Result<()> {
        match made {
            Err(e) if self.builder.options.lenient => {
                self.builder.warn(format!("{e}; left out"));
                Ok(())
            }
            made => made,
        }
    }

    fn transform(&mut self, name: &str, place: &Place) -> Result<()> {
        let lexer = self.lexer()?;
        let step = match name {
            "Identity" => {
                self.state.world_from_object = DAffine3::IDENTITY;
                return Ok(());
            }
            "CoordSysTransform" => {
                let system = lexer.text("a name")?;
                let unknown = || place.invalid(format!("there is no coordinate system {system:?}"));
                self.state.world_from_object = *self.systems.get(&system).ok_or_else(unknown)?;
                return Ok(());
            }
            "Translate" => DAffine3::from_translation(DVec3::from(lexer.numbers::<3>(name)?)),
            "Scale" => DAffine3::from_scale(DVec3::from(lexer.numbers::<3>(name)?)),
            "Rotate" => {
                let [angle, x, y, z] = lexer.numbers::<4>(name)?;
                let axis = DVec3::new(x, y, z).try_normalize();
                let axis = axis.ok_or_else(|| place.invalid("Rotate has no axis"))?;
                DAffine3::from_axis_angle(axis, angle.to_radians())
            }
            "LookAt" => {
                let v = lexer.numbers::<9>(name)?;
                look_at(&v).ok_or_else(|| place.invalid("LookAt: eye, target and up are degenerate"))?
            }
            _ => {
                let m = DMat4::from_cols_array(&lexer.numbers::<16>(name)?);
                if m.row(3).truncate().abs().max_element() > 1e-9 || m.w_axis.w == 0.0 {
                    return Err(place.unsupported("a matrix with perspective; only affine ones are read"));
                }
                DAffine3::from_mat4(m * m.w_axis.w.recip())
            }
        };
        self.state.world_from_object = if name == "Transform" { step } else { self.state.world_from_object * step };
        if !self.state.world_from_object.is_finite() {
            return Err(place.invalid("the transform is not finite"));
        }
        Ok(())
    }

    fn scope(&mut self, name: &str, place: &Place) -> Result<()> {
        if name.ends_with("Begin") {
            if self.saved.len() >= DEEPEST {
                return Err(place.unsupported(format!("attributes nest deeper than {DEEPEST}")));
            }
            self.saved.push(self.state.clone());
            return Ok(());
        }
        let Some(saved) = self.saved.pop() else {
            return Err(place.invalid(format!("{name} without a beginning")));
        };
        if name == "TransformEnd" {
            self.state.world_from_object = saved.world_from_object;
        } else {
            self.state = saved;
        }
        Ok(())
    }

    fn object(&mut self, directive: &str, place: &Place) -> Result<()> {
        match directive {
            "ObjectBegin" => {
                let name = self.lexer()?.text("a name")?;
                if self.group.is_some() {
                    return Err(place.invalid("ObjectBegin inside of ObjectBegin"));
                }
                self.scope("AttributeBegin", place)?;
                self.group = Some((name.clone(), Group { name, shapes: Vec::new() }));
            }
            "ObjectEnd" => {
                let Some((name, group)) = self.group.take() else {
                    return Err(place.invalid("ObjectEnd without ObjectBegin"));
                };
                self.scope("AttributeEnd", place)?;
                self.builder.scene.groups.push(group);
                self.groups.insert(name, GroupId(self.builder.scene.groups.len() - 1));
            }
            _ => {
                let name = self.lexer()?.text("a name")?;
                let Some(&group) = self.groups.get(&name) else {
                    return Err(place.invalid(format!("there is no object {name:?}")));
                };
                if self.group.is_some() {
                    return Err(place.invalid("ObjectInstance inside of ObjectBegin"));
                }
                let world_from_group = self.placed(place)?;
                self.builder.scene.instances.push(Instance { group, world_from_group });
            }
        }
        Ok(())
    }

    /// The current transform, if it can be turned back.
    fn placed(&self, place: &Place) -> Result<DAffine3> {
        let m = self.state.world_from_object;
        if check::is_invertible(&m) { Ok(m) } else { Err(place.invalid("the transform is degenerate")) }
    }

    fn medium_interface(&mut self, place: &Place) -> Result<()> {
        let inside = self.lexer()?.text("a medium")?;
        let outside = match self.lexer()?.peek()? {
            Some(Token::Text(_)) => self.lexer()?.text("a medium")?,
            _ => inside.clone(),
        };
        let find = |name: &String| match name.as_str() {
            "" => Ok(None),
            name => match self.media.get(name) {
                Some(&id) => Ok(Some(id)),
                None => Err(place.invalid(format!("there is no medium {name:?}"))),
            },
        };
        (self.state.interior, self.state.exterior) = (find(&inside)?, find(&outside)?);
        Ok(())
    }

    /// After a directive: parameters nobody asked for.
    fn finish(&mut self, kind: &str, parameters: &Parameters) {
        for p in parameters.list.iter().filter(|p| !p.used.get()) {
            let what = format!("parameter {:?} of {kind:?} is not known and not used", p.name);
            if self.told.insert(what.clone()) {
                self.builder.warn(p.place.warning(what));
            }
        }
    }
}

/// pbrt's LookAt, camera from world.
fn look_at(v: &[f64; 9]) -> Option<DAffine3> {
    let [eye, target, up] = [0, 3, 6].map(|i| DVec3::new(v[i], v[i + 1], v[i + 2]));
    let forward = (target - eye).try_normalize()?;
    let right = up.cross(forward).try_normalize()?;
    let world_from_camera = DAffine3::from_cols(right, forward.cross(right), forward, eye);
    Some(world_from_camera.inverse())
}
