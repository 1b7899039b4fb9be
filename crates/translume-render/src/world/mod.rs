//! A scene made ready for light transport.

pub(crate) mod bend;
mod build;
mod hit;
mod translucent;

use crate::camera::CameraSample;
use crate::light::{End, LightPoint, LightVisibilityCache, Lights, light_of};
use crate::material::{Mixture, Prepared, Shader};
use crate::medium::Tracked;
use crate::texture;
use crate::{Error, PathSampler, Result, Rgb};
pub(crate) use build::world as compile;
use glam::{DAffine3, Vec2, Vec3};
pub use hit::{Shading, SurfaceHit};
use std::collections::HashMap;
use std::sync::Arc;
pub use translucent::Entry;
pub(crate) use translucent::Translucent;
use translume_bxdf::{Flags, Mode};
use translume_core::sampler::Sampler;
use translume_mesh::TriMesh;
use translume_scene::{MaterialId, MediumId, Scene, TextureId};
use translume_trace::{Ray, SurfacePoint};

/// Surfaces that a connection may pass straight before it counts as blocked.
pub(crate) const MOST_CROSSINGS: u32 = 256;

/// A compiled scene.
pub struct World {
    scene: Arc<Scene>,
    tracer: translume_trace::Scene,
    /// Surfaces, geometry after geometry.
    surfaces: Vec<Surface>,
    /// Per instance of the tracer: where its geometry's surfaces begin.
    bases: Vec<u32>,
    prepared: Vec<Prepared>,
    /// Per material, where it is a blend.
    mixtures: Vec<Option<Mixture>>,
    lights: Lights,
    media: Vec<Tracked>,
    /// Translucent shapes, by instance of the tracer and surface.
    translucent: HashMap<(u32, u32), Translucent>,
    /// Some surface lets light pass straight.
    has_null: bool,
    center: Vec3,
    radius: f32,
    /// Distance of the farthest point from the origin, for what is relative to coordinates.
    reach: f32,
}

/// What is known of a surface beside its place.
#[derive(Clone)]
pub(crate) struct Surface {
    form: Form,
    material: MaterialId,
    /// Light may pass the surface straight; in any way.
    passes: (bool, bool),
    /// What the surface does depends on the side that it is seen from.
    sided: bool,
    radiance: Option<TextureId>,
    /// Number of the light that the first primitive is.
    pub(crate) first_light: Option<u32>,
    /// The same of the other side.
    pub(crate) first_light_behind: Option<u32>,
    /// All primitives are that one light.
    pub(crate) one_light: bool,
    flip: bool,
    /// The subsurface material that `material` is, through adapters.
    subsurface: Option<MaterialId>,
    interior: Option<MediumId>,
    exterior: Option<MediumId>,
}

#[derive(Clone)]
enum Form {
    Mesh(Arc<TriMesh>),
    /// A quadric; the map leads from the tracer's geometry to its own space.
    Quadric(Box<(translume_scene::Geometry, DAffine3)>),
}

impl World {
    /// Compiles `scene`: builds the acceleration structures, tabulates materials, collects lights.
    ///
    /// # Errors
    /// [`Error::TooLarge`]; [`Error::Scene`] for a scene without light.
    pub fn new(scene: Arc<Scene>) -> Result<Self> {
        let world = build::world(scene)?;
        if world.lights.is_empty() {
            return Err(Error::Scene("the scene has no light that shines: the picture would be black".into()));
        }
        Ok(world)
    }

    /// The description.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// All lights.
    pub fn lights(&self) -> &Lights {
        &self.lights
    }

    /// Centre and radius of a sphere around all surfaces.
    pub fn bounding_sphere(&self) -> (Vec3, f32) {
        (self.center, self.radius)
    }

    /// What the ray meets first.
    #[inline]
    pub fn intersect(&self, ray: &Ray) -> Option<SurfaceHit> {
        let hit = self.tracer.intersect(ray)?;
        Some(self.surface_hit(ray, &hit))
    }

    /// Whether `there` is true of a place, and its parameter, where a walk along the ray arrives: it goes on behind what lets
    /// something pass straight, by chance as walks do, or always without a sampler; what does nothing else is no place.
    #[inline]
    pub(crate) fn arrives(
        &self,
        ray: &Ray,
        mut sampler: Option<&mut PathSampler>,
        mut there: impl FnMut(&SurfacePoint, f32) -> bool,
    ) -> bool {
        let (mut ray, mut before) = (*ray, 0.0);
        for _ in 0..MOST_CROSSINGS {
            let Some(hit) = self.tracer.intersect(&ray) else { return false };
            if !self.has_null || !self.surfaces[self.surface_index(&hit)].passes.0 {
                return there(&self.tracer.surface(&ray, &hit), before + hit.t);
            }
            let hit = self.surface_hit(&ray, &hit);
            let shading = self.shading(&hit);
            if shading.flags().has_smooth() && there(&hit.point, before + hit.t) {
                return true;
            }
            let passes = match sampler.as_deref_mut() {
                Some(s) => shading
                    .sample(hit.wo, s.next_1d(), s.next_2d(), Mode::Importance)
                    .is_some_and(|s| s.flags.contains(Flags::NULL)),
                None => shading.bsdf.null_transmittance(shading.to_local(hit.wo)) != Rgb::ZERO,
            };
            if !passes {
                return false;
            }
            before += hit.t;
            ray = hit.go_on(&ray);
        }
        false
    }

    /// What the ray meets first when shapes that shine are not there.
    pub fn intersect_behind_lights(&self, ray: &Ray) -> Option<SurfaceHit> {
        let (mut ray, mut t) = (*ray, 0.0);
        loop {
            let hit = self.intersect(&ray)?;
            if self.surfaces[hit.surface as usize].radiance.is_none() {
                return Some(SurfaceHit { t: t + hit.t, ..hit });
            }
            t += hit.t;
            ray = hit.go_on(&ray);
        }
    }

    /// The BSDF at `hit` with its frame.
    #[inline]
    pub fn shading(&self, hit: &SurfaceHit) -> Shading<'_> {
        let surface = &self.surfaces[hit.surface as usize];
        let (scene, prepared, under) = (&self.scene, &self.prepared, self.translucent(hit));
        let standing =
            (!self.tracer.is_in_place(hit.instance)).then(|| &self.tracer.instances()[hit.instance as usize]);
        let place = self.place(hit);
        let mut shader = Shader {
            scene,
            prepared,
            mixtures: &self.mixtures,
            hit,
            standing,
            under,
            place,
            frame: hit.frame,
            bend: None,
            turned: false,
        };
        let bsdf = shader.bsdf(surface.material);
        Shading { bsdf, frame: shader.frame, bend: shader.bend }
    }

    /// What [`World::shading`] is when the surface is seen from the direction `wo` instead; `own` is that of `hit` itself.
    #[inline]
    pub fn shading_from<'a>(&'a self, hit: &SurfaceHit, own: &Shading<'a>, wo: Vec3) -> Shading<'a> {
        match self.surfaces[hit.surface as usize].sided {
            true => self.shading(&SurfaceHit { wo, ..*hit }),
            false => own.clone(),
        }
    }

    /// Whether any surface has a medium on one of its sides.
    pub fn has_media(&self) -> bool {
        self.surfaces.iter().any(|s| s.interior.is_some() || s.exterior.is_some())
    }

    /// Whether the surface at `hit` is a light's.
    pub fn is_light(&self, hit: &SurfaceHit) -> bool {
        self.surfaces[hit.surface as usize].radiance.is_some()
    }

    /// What of the light that leaves `hit` for the camera gets there, past at most `most` surfaces that let it pass. With
    /// `hide_lights`, lights are not there for the camera's rays, up to the first such surface.
    pub fn transmittance_to_camera(
        &self,
        camera: &CameraSample,
        hit: &SurfaceHit,
        hide_lights: bool,
        most: u32,
    ) -> Rgb {
        let d = hit.point.origin_towards(camera.wi) - camera.near;
        let mut ray = Ray { o: camera.near, d, t_min: 0.0, t_max: 1.0 };
        if !hide_lights {
            return self.transmittance(&ray, most);
        }
        while let Some(found) = self.intersect(&ray) {
            if !self.is_light(&found) {
                return self.transmittance(&ray, most);
            }
            ray = found.go_on(&ray);
        }
        if self.is_light(hit) { Rgb::ZERO } else { Rgb::ONE }
    }

    /// Radiance that the surface at `hit` emits towards `hit.wo`, and the light's number.
    #[inline]
    pub fn emission(&self, hit: &SurfaceHit) -> Option<(Rgb, usize)> {
        let surface = &self.surfaces[hit.surface as usize];
        let radiance = surface.radiance?;
        let cos = hit.wo.dot(hit.n());
        let light = light_of(surface, hit.prim, cos < 0.0).filter(|_| cos != 0.0)?;
        Some((texture::eval(&self.scene, radiance, &self.place(hit)), light))
    }

    /// The normal at `hit` for [`Lights::sample`]: on the side of `wo`, or zero where light may come from any side.
    #[inline]
    pub fn receiving_normal(&self, hit: &SurfaceHit, shading: &Shading) -> Vec3 {
        if self.surfaces[hit.surface as usize].passes.1 {
            return Vec3::ZERO;
        }
        let n = shading.normal_for(hit.wo);
        if n.dot(hit.wo) < 0.0 { -n } else { n }
    }

    /// [`Lights::pdf_direct`] at `hit`, for the point `q` of a light along `wi`.
    #[inline]
    pub(crate) fn pdf_direct(
        &self,
        hit: &SurfaceHit,
        shading: &Shading,
        seen: Option<&LightVisibilityCache>,
        q: &LightPoint,
        wi: Vec3,
    ) -> f32 {
        self.lights.pdf_direct(hit.point.p, self.receiving_normal(hit, shading), seen, q, wi)
    }

    /// Medium numbers on the two sides of the surface at `hit`, if it separates media: away from the normal, and on its side.
    #[inline]
    pub fn media(&self, hit: &SurfaceHit) -> Option<(Option<MediumId>, Option<MediumId>)> {
        let surface = &self.surfaces[hit.surface as usize];
        let boundary = surface.interior.is_some() || surface.exterior.is_some();
        boundary.then_some((surface.interior, surface.exterior))
    }

    /// The segment from `from` to a light, `wi` its direction; t runs from 0 to 1 but for lights far away.
    #[inline]
    pub fn segment(from: &SurfacePoint, wi: Vec3, end: &End) -> Ray {
        match end {
            End::Surface(point) => from.segment_between(point),
            End::Point(p) => from.segment_to(*p),
            End::Far => from.spawn(wi),
        }
    }

    /// What of the light along `ray` passes the surfaces within its limits, at most `most` of them; media do not count.
    #[inline]
    pub fn transmittance(&self, ray: &Ray, most: u32) -> Rgb {
        if !self.has_null || most == 0 {
            return if self.tracer.occluded(ray) { Rgb::ZERO } else { Rgb::ONE };
        }
        let (mut ray, mut value) = (*ray, Rgb::ONE);
        for crossed in 0.. {
            let Some(hit) = self.tracer.intersect(&ray) else { return value };
            if crossed >= most || !self.surfaces[self.surface_index(&hit)].passes.0 {
                return Rgb::ZERO;
            }
            let hit = self.surface_hit(&ray, &hit);
            value *= self.straight_through(&hit);
            if value == Rgb::ZERO {
                return value;
            }
            ray = hit.go_on(&ray);
        }
        Rgb::ZERO
    }

    /// A medium.
    /// Whether nothing at all is on `segment`, not even what lets light pass.
    pub(crate) fn is_clear(&self, segment: &Ray) -> bool {
        !self.tracer.occluded(segment)
    }

    /// Whether any surface lets light pass straight.
    pub(crate) fn has_null(&self) -> bool {
        self.has_null
    }

    pub(crate) fn medium(&self, id: MediumId) -> &Tracked {
        &self.media[id.0]
    }

    /// What of the light along the ray that found `hit` passes the surface straight.
    pub(crate) fn straight_through(&self, hit: &SurfaceHit) -> Rgb {
        if !self.surfaces[hit.surface as usize].passes.0 {
            return Rgb::ZERO;
        }
        let shading = self.shading(hit);
        shading.bsdf.null_transmittance(shading.to_local(hit.wo))
    }

    #[inline]
    fn surface_index(&self, hit: &translume_trace::Hit) -> usize {
        (self.bases[hit.instance as usize] + hit.part) as usize
    }
}

impl SurfaceHit {
    /// The rest of `ray` behind this hit: to the same end, its parameter counted on from [`SurfaceHit::t`].
    #[inline]
    pub fn go_on(&self, ray: &Ray) -> Ray {
        let o = self.point.origin_towards(ray.d);
        let rest = ray.t_max - self.t;
        if rest.is_infinite() {
            return Ray { o, d: ray.d, t_min: 0.0, t_max: rest };
        }
        // The origin has moved off the surface. Moved along with it, the end would lie behind what it stops short of.
        let d = (ray.at(ray.t_max) - o) / rest;
        match d.dot(ray.d) > 0.0 {
            true => Ray { o, d, t_min: 0.0, t_max: rest },
            false => Ray { o, d: ray.d, t_min: 0.0, t_max: 0.0 }, // the surface is as near as the end
        }
    }

    /// Texture coordinates.
    pub fn uv(&self) -> Vec2 {
        self.uv
    }
}
