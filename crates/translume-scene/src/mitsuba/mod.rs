//! Mitsuba scenes in XML, in the dialects 0.4–0.6, 2.x and 3.x.
//!
//! What the formats leave open, and defaults, are as Mitsuba 3 has them (its RGB variants), also for older files, except:
//! metals without a material are copper before 2.0; shapes with media but without a BSDF are index-matched
//! boundaries before 2.0; grids of 0.6 have samples on the faces of their box; `uoffset` is added after `uscale`.
//! Objects that nothing refers to are not looked at.

mod attribute;
mod bsdf;
mod camera;
mod light;
mod object;
mod properties;
mod shape;
mod subsurface;
mod texture;
mod tree;
mod volume;

use crate::builder::Builder;
use crate::scene::{GroupId, LoadOptions, MaterialId, MediumId, Scene, TextureId};
use crate::spectrum::Quantity;
use crate::{Error, Result};
use object::{Child, Object, Target};
use std::collections::{BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use translume_mesh::TriMesh;
pub(crate) use tree::read_text;
use tree::{Element, Place};

/// References do not lead deeper.
const DEEPEST: usize = 200;

/// Reads a scene file.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] with the line for damaged files, wrong references, degenerate transforms;
/// [`Error::Unsupported`] for elements that change the picture and are not known here, unless `options.lenient`.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene> {
    let text = tree::read_text(path)?;
    let tree = tree::read(path, &text, &options.defines)?;
    let mut loader = Loader::new(path, options, &tree)?;
    loader.scene(&tree.root)?;
    crate::check::instances(&loader.builder.scene, path)?;
    Ok(loader.builder.finish())
}

struct Loader {
    builder: Builder,
    folders: Vec<PathBuf>,
    /// Major version of the dialect: 0 for 0.x.
    version: u32,
    ids: HashMap<String, Rc<Object>>,
    /// What objects became, by their address (they live as long as `objects` below).
    materials: HashMap<*const Object, MaterialId>,
    textures: HashMap<(*const Object, Quantity), TextureId>,
    media: HashMap<*const Object, MediumId>,
    groups: HashMap<*const Object, GroupId>,
    /// Objects being made, to find circles.
    busy: Vec<*const Object>,
    /// Warnings about unknown properties given, by class, plugin and property.
    told: HashSet<(String, String, String)>,
    objects: Vec<Child>,
    /// Shapes made so far.
    stood: usize,
    /// Area lights that a shape refers to.
    worn: HashSet<*const Object>,
    /// The attributes of meshes that textures and materials look at, and those of what is being made.
    attributes: HashMap<TextureId, BTreeSet<String>>,
    attributes_of: HashMap<MaterialId, BTreeSet<String>>,
    asked: BTreeSet<String>,
    /// Meshes with attributes, by those without.
    colored: HashMap<(*const TriMesh, String), Option<Arc<TriMesh>>>,
    /// The rectangle and the cube.
    unit_meshes: [Option<Arc<TriMesh>>; 2],
}

impl Loader {
    fn new(path: &Path, options: &LoadOptions, tree: &tree::Tree) -> Result<Self> {
        let root = &tree.root;
        if root.tag != "scene" {
            return Err(root.place.invalid(format!("the file holds a <{}>, not a <scene>", root.tag)));
        }
        let mut builder = Builder::new(path, options);
        builder.scene.warnings.clone_from(&tree.warnings);
        let version = match root.get("version") {
            Some(text) => match text.split('.').next().and_then(|major| major.trim().parse().ok()) {
                Some(major) => major,
                None => return Err(root.place.invalid(format!("{text:?} is no version"))),
            },
            None => {
                builder.warn(root.place.warning("the scene has no version; it is read as 3.0.0"));
                3
            }
        };
        Ok(Self {
            builder,
            folders: tree.folders.clone(),
            version,
            ids: HashMap::new(),
            materials: HashMap::new(),
            textures: HashMap::new(),
            media: HashMap::new(),
            groups: HashMap::new(),
            busy: Vec::new(),
            told: HashSet::new(),
            objects: Vec::new(),
            stood: 0,
            worn: HashSet::new(),
            attributes: HashMap::new(),
            attributes_of: HashMap::new(),
            asked: BTreeSet::new(),
            colored: HashMap::new(),
            unit_meshes: [None, None],
        })
    }

    /// Whether the dialect is one of 0.4–0.6.
    fn is_old(&self) -> bool {
        self.version < 2
    }

    /// Builds all objects, then makes what stands in the scene.
    fn scene(&mut self, root: &Element) -> Result<()> {
        let mut context = object::Context { folders: &self.folders, warnings: Vec::new() };
        let mut children = Vec::new();
        for element in &root.children {
            let built = object::scene_child(element, &mut context);
            if let (Err(e), true) = (&built, self.builder.options.lenient) {
                context.warnings.push(format!("{e}; left out"));
                continue;
            }
            children.extend(built?);
        }
        self.builder.scene.warnings.append(&mut context.warnings);
        children.iter().for_each(|c| self.register(c));
        for element in root.children.iter().filter(|e| e.tag == "alias") {
            let (id, new) = (element.need("id")?, element.need("as")?);
            let Some(object) = self.ids.get(id) else {
                return Err(element.place.invalid(format!("<alias>: nothing has the id {id:?}")));
            };
            self.ids.insert(new.to_owned(), object.clone());
        }
        self.objects = children;
        for i in 0..self.objects.len() {
            // References at the top are a way of writing the object there.
            let (target, place) = (self.objects[i].target.clone(), self.objects[i].place.clone());
            let object = self.resolve(&target, &place)?;
            let made = self.stand(&object);
            self.skippable(made, || ())?;
        }
        for child in &self.objects {
            let Target::Object(object) = &child.target else { continue };
            if is_area_light(object) && !self.worn.contains(&Rc::as_ptr(object)) {
                let what = format!("{} does not shine: no shape refers to it", object.title());
                self.builder.warn(object.place.warning(what));
            }
        }
        Ok(())
    }

    /// Makes an object that stands in the scene by itself.
    fn stand(&mut self, object: &Rc<Object>) -> Result<()> {
        match object.class.as_str() {
            "shape" => {
                let shapes = self.shape(object)?;
                self.builder.scene.shapes.extend(shapes);
            }
            "emitter" if is_area_light(object) => {} // shines where a shape refers to it
            "emitter" => self.emitter(object)?,
            "sensor" => {
                let sensor = self.sensor(object)?;
                self.builder.scene.sensors.push(sensor);
            }
            "integrator" => self.integrator(object)?,
            _ => {} // used where something refers to it
        }
        Ok(())
    }

    /// Notes the ids of an object and of those in it.
    fn register(&mut self, child: &Child) {
        let Target::Object(object) = &child.target else { return };
        if !object.id.is_empty() && self.ids.insert(object.id.clone(), object.clone()).is_some() {
            let what = format!("a second object with the id {:?}; this one is taken", object.id);
            self.builder.warn(object.place.warning(what));
        }
        object.children.iter().for_each(|c| self.register(c));
    }

    /// The object itself, or what the reference names.
    fn resolve(&self, target: &Target, place: &Place) -> Result<Rc<Object>> {
        match target {
            Target::Object(object) => Ok(object.clone()),
            Target::Reference(id) => {
                self.ids.get(id).cloned().ok_or_else(|| place.invalid(format!("nothing has the id {id:?}")))
            }
        }
    }

    /// Runs `make` on an object unless it is being made already: then the scene goes in circles.
    fn guarded<T>(&mut self, object: &Object, make: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        let address = std::ptr::from_ref(object);
        if self.busy.contains(&address) {
            return Err(object.place.invalid(format!("<{}> {:?} refers to itself", object.class, object.id)));
        }
        if self.busy.len() >= DEEPEST {
            return Err(object.place.unsupported(format!("references nest deeper than {DEEPEST}")));
        }
        self.busy.push(address);
        let made = make(self);
        self.busy.pop();
        made
    }

    /// Passes an error on, or with [`LoadOptions::lenient`] makes it a warning and takes `instead`.
    fn skippable<T>(&mut self, made: Result<T>, instead: impl FnOnce() -> T) -> Result<T> {
        match made {
            Err(e) if self.builder.options.lenient => {
                self.builder.warn(format!("{e}; left out"));
                Ok(instead())
            }
            made => made,
        }
    }

    /// The file that a property names.
    fn file(&self, object: &Object, property: &str) -> Result<PathBuf> {
        let Some(name) = object.text(property)? else {
            return Err(object.place.invalid(format!("{} has no {property:?}", object.title())));
        };
        Ok(tree::find(&self.folders, name, &object.place))
    }

    /// After an object is made: what it holds that nobody asked for.
    fn finish(&mut self, object: &Object) -> Result<()> {
        for property in object.properties.iter().filter(|p| !p.used.get()) {
            if properties::WITHOUT_EFFECT.contains(&property.name.as_str()) {
                continue;
            }
            let key = (object.class.clone(), object.plugin.clone(), property.name.clone());
            if self.told.insert(key) {
                let what = format!("property {:?} of {} is not known and not used", property.name, object.title());
                self.builder.warn(property.place.warning(what));
            }
        }
        for child in object.children.iter().filter(|c| !c.used.get()) {
            let resolved = self.resolve(&child.target, &child.place)?;
            let what = format!("{} does not know what to do with {}", object.title(), resolved.title());
            let refused = Err(child.place.unsupported(what));
            self.skippable(refused, || ())?;
        }
        // Something else may refer to the same object and make it again (a film of two cameras).
        object.children.iter().for_each(|c| c.used.set(false));
        Ok(())
    }

    fn integrator(&mut self, object: &Rc<Object>) -> Result<()> {
        // Wrappers (aov, moment, adaptive, irrcache) hold the one that makes the picture.
        if let Some(inner) = self.child_of_class(object, "integrator")? {
            object.properties.iter().for_each(|p| p.used.set(true));
            return self.guarded(&object.clone(), |l| l.integrator(&inner));
        }
        let depth = |name: &str, default: i64| -> Result<Option<u32>> {
            let depth = object.integer(name)?.unwrap_or(default);
            Ok(u32::try_from(depth).ok())
        };
        let direct = if object.plugin == "direct" { 2 } else { -1 };
        self.builder.scene.integrator = crate::Integrator {
            name: object.plugin.clone(),
            max_depth: depth("max_depth", direct)?,
            rr_depth: depth("rr_depth", 5)?.unwrap_or(u32::MAX),
            hide_emitters: object.boolean("hide_emitters", false)?,
        };
        // Methods have parameters of their own, which say nothing about the scene.
        object.properties.iter().for_each(|p| p.used.set(true));
        self.finish(object)
    }

    /// The first unused nested object of a class, in place or by reference.
    fn child_of_class(&self, object: &Object, class: &str) -> Result<Option<Rc<Object>>> {
        for child in object.children.iter().filter(|c| !c.used.get()) {
            let resolved = self.resolve(&child.target, &child.place)?;
            if resolved.class == class {
                child.used.set(true);
                return Ok(Some(resolved));
            }
        }
        Ok(None)
    }

    /// The nested object with a role.
    fn child_named(&self, object: &Object, name: &str) -> Result<Option<Rc<Object>>> {
        let Some(child) = object.children.iter().find(|c| c.name == name) else { return Ok(None) };
        child.used.set(true);
        self.resolve(&child.target, &child.place).map(Some)
    }
}

/// A light that shapes wear, which stands by itself only to be referred to.
fn is_area_light(object: &Object) -> bool {
    object.class == "emitter" && object.plugin == "area" && !object.id.is_empty()
}

impl Object {
    /// How messages call it.
    fn title(&self) -> String {
        match self.id.as_str() {
            "" => format!("{} {:?}", self.class, self.plugin),
            id => format!("{} {:?} (id {id:?})", self.class, self.plugin),
        }
    }

    fn unsupported(&self) -> Error {
        self.place.unsupported(format!("{} is not supported", self.title()))
    }
}
