//! Which channels of an OpenEXR file make the picture: by the names that the format and its programs give them.
//!
//! A layer is the part of a channel's name before the last dot, and within one R, G, B (in either case, or written out)
//! are colour, Y is luminance and RY, BY chroma. A Y beside X or Z is a coordinate. Deep parts are passed over.

use crate::{Error, Result};
use exr::meta::header::Header;
use std::path::Path;

/// Which channel of a part goes where.
#[derive(Debug)]
pub(crate) struct Roles {
    /// Channel indices of red, green, blue; or of gray alone; or of RY, Y, BY. A colour that is missing is zero.
    colour: Vec<Option<usize>>,
    alpha: Option<usize>,
    pub luma_chroma: bool,
}

impl Roles {
    /// The roles of the channels that `prefix` leads, if they make a picture of all its colours.
    pub(crate) fn of(header: &Header, prefix: &str) -> Option<Self> {
        let layer = Names::new(header, prefix);
        let alpha = layer.find(&["a", "alpha"]);
        if let Some(colour) = layer.all([&["r", "red"], &["g", "green"], &["b", "blue"]]) {
            return Some(Self { colour, alpha, luma_chroma: false });
        }
        if let Some(colour) = layer.all([&["ry"], &["y"], &["by"]]) {
            return Some(Self { colour, alpha, luma_chroma: true });
        }
        let coordinates = layer.find(&["x"]).is_some() || layer.find(&["z"]).is_some();
        let luminance = layer.find(&["y"]).filter(|_| !coordinates)?;
        Some(Self { colour: vec![Some(luminance)], alpha, luma_chroma: false })
    }

    /// Some of red, green and blue: those that are missing are zero, as in OpenEXR's own reader. One alone is gray.
    fn partial(header: &Header, prefix: &str) -> Option<Self> {
        let layer = Names::new(header, prefix);
        let alpha = layer.find(&["a", "alpha"]);
        let colour = [layer.find(&["r", "red"]), layer.find(&["g", "green"]), layer.find(&["b", "blue"])];
        let there: Vec<_> = colour.iter().copied().filter(Option::is_some).collect();
        match there.len() {
            0 => None,
            1 => Some(Self { colour: there, alpha, luma_chroma: false }),
            _ => Some(Self { colour: colour.to_vec(), alpha, luma_chroma: false }),
        }
    }

    /// The coordinates of a vector as red, green, blue; or the only channel as gray.
    fn of_numbers(header: &Header, prefix: &str) -> Option<Self> {
        let layer = Names::new(header, prefix);
        if let Some(colour) = layer.all([&["x"], &["y"], &["z"]]) {
            return Some(Self { colour, alpha: None, luma_chroma: false });
        }
        let [only] = layer.0.as_slice() else { return None };
        Some(Self { colour: vec![Some(only.1)], alpha: None, luma_chroma: false })
    }

    pub(crate) fn slots(&self) -> usize {
        self.colour.len() + usize::from(self.alpha.is_some())
    }

    /// The place of channel `channel` in an output pixel.
    pub(crate) fn slot(&self, channel: usize) -> Option<usize> {
        let colour = self.colour.iter().position(|&c| c == Some(channel));
        colour.or_else(|| (self.alpha == Some(channel)).then_some(self.colour.len()))
    }

    /// The colours that are not there.
    fn missing(&self) -> Vec<&'static str> {
        ["red", "green", "blue"].iter().zip(&self.colour).filter(|(_, c)| c.is_none()).map(|(n, _)| *n).collect()
    }
}

/// The channels of one layer: names in lower case without it, with their numbers.
struct Names(Vec<(String, usize)>);

impl Names {
    fn new(header: &Header, prefix: &str) -> Self {
        let channels = header.channels.list.iter().enumerate();
        let own = |(i, name): (usize, String)| {
            let rest = name.strip_prefix(prefix)?;
            (!rest.contains('.')).then(|| (rest.to_lowercase(), i))
        };
        Self(channels.map(|(i, c)| (i, c.name.to_string())).filter_map(own).collect())
    }

    fn find(&self, names: &[&str]) -> Option<usize> {
        self.0.iter().find(|(n, _)| names.contains(&n.as_str())).map(|n| n.1)
    }

    fn all(&self, names: [&[&str]; 3]) -> Option<Vec<Option<usize>>> {
        let found = names.map(|n| self.find(n));
        found.iter().all(Option::is_some).then(|| found.to_vec())
    }
}

/// A layer of a part: `prefix` with its dot, empty for the part's own channels.
struct Layer<'a> {
    part: usize,
    header: &'a Header,
    prefix: String,
}

impl Layer<'_> {
    /// As `--layer` style options take it: the layer, or the part.
    fn name(&self) -> String {
        let part = self.header.own_attributes.layer_name.as_ref().map(ToString::to_string).unwrap_or_default();
        if self.prefix.is_empty() { part } else { self.prefix.trim_end_matches('.').to_owned() }
    }

    /// Whether its name says that it is the picture, not one of the layers that go into it or describe it.
    fn is_beauty(&self) -> bool {
        let name = self.name().to_lowercase();
        let last = name.rsplit(['.', '/']).next().unwrap_or_default();
        matches!(last, "beauty" | "combined" | "composite" | "rgba" | "rgb" | "color" | "colour" | "main" | "final")
    }
}

/// The flat layers of all parts: a part's own channels, then those with names, in the order of the file.
fn layers(headers: &[Header]) -> Vec<Layer<'_>> {
    let mut out: Vec<Layer<'_>> = Vec::new();
    for (part, header) in headers.iter().enumerate().filter(|(_, h)| !h.deep) {
        let mut prefixes = vec![String::new()];
        for channel in &header.channels.list {
            let name = channel.name.to_string();
            let prefix = name.rfind('.').map_or("", |dot| &name[..=dot]);
            if !prefixes.iter().any(|p| p == prefix) {
                prefixes.push(prefix.to_owned());
            }
        }
        out.extend(prefixes.into_iter().map(|prefix| Layer { part, header, prefix }));
    }
    out
}

/// The picture of a file: plain R, G, B (or Y) before named layers, the one whose name says so before others, whole
/// colours before some of them, those before a lone channel. A choice between equals is a warning.
pub(crate) fn choose(headers: &[Header], path: &Path) -> Result<(usize, Roles)> {
    let all = layers(headers);
    let plain = |l: &&Layer<'_>| l.prefix.is_empty();
    let with = |roles: &dyn Fn(&Header, &str) -> Option<Roles>, unnamed: bool| -> Vec<(&Layer<'_>, Roles)> {
        let fitting = all.iter().filter(|l| plain(l) == unnamed);
        fitting.filter_map(|l| Some((l, roles(l.header, &l.prefix)?))).collect()
    };
    let choices = [
        with(&Roles::of, true),
        with(&Roles::of, false),
        with(&Roles::partial, true),
        with(&Roles::partial, false),
        // A part's only channel, as gray; vectors only for those who ask for them by name.
        with(&|h, p| Roles::of_numbers(h, p).filter(|r| r.colour.len() == 1 && h.channels.list.len() == 1), true),
        with(&|h, p| Roles::of_numbers(h, p).filter(|r| r.colour.len() == 1 && h.channels.list.len() == 1), false),
    ];
    let Some(mut found) = choices.into_iter().find(|c| !c.is_empty()) else { return Err(nothing(headers, &all, path)) };
    let named: Vec<String> = found.iter().map(|(l, _)| l.name()).collect();
    let best = found.iter().position(|(l, _)| l.is_beauty());
    let (layer, roles) = found.swap_remove(best.unwrap_or(0));
    let path = path.display();
    if best.is_none() && named.len() > 1 {
        log::warn!("{path}: several layers hold a picture ({}); '{}' is read", named.join(", "), layer.name());
    }
    let missing = roles.missing();
    if !missing.is_empty() {
        log::warn!("{path}: it has no channel for {}: taken for 0", missing.join(" and "));
    } else if roles.colour.len() == 1 && roles.alpha.is_some() && Roles::of(layer.header, &layer.prefix).is_none() {
        log::warn!("{path}: its only colour channel is read as gray");
    }
    Ok((layer.part, roles))
}

fn nothing(headers: &[Header], layers: &[Layer<'_>], path: &Path) -> Error {
    if headers.iter().all(|h| h.deep) {
        return Error::unsupported(path, "a deep OpenEXR picture; flatten it first");
    }
    let channels = headers.iter().filter(|h| !h.deep).flat_map(|h| &h.channels.list);
    let channels: Vec<String> = channels.map(|c| c.name.to_string()).take(12).collect();
    let of_numbers = layers.iter().filter(|l| Roles::of_numbers(l.header, &l.prefix).is_some());
    let names: Vec<String> = of_numbers.map(Layer::name).filter(|n| !n.is_empty()).take(12).collect();
    let channels = channels.join(", ");
    if names.is_empty() {
        return Error::unsupported(path, format!("no R, G, B or Y among the channels {channels}"));
    }
    Error::Layers { path: path.to_owned(), channels, layers: names }
}

/// The part called `layer`, or the part with channels that have `layer` and a dot in front.
pub(crate) fn choose_layer(headers: &[Header], layer: &str, path: &Path) -> Result<(usize, Roles)> {
    let all = layers(headers);
    let called = |l: &&Layer<'_>| l.name() == layer;
    let roles = |l: &Layer<'_>| {
        let any = || Roles::partial(l.header, &l.prefix).or_else(|| Roles::of_numbers(l.header, &l.prefix));
        Some((l.part, Roles::of(l.header, &l.prefix).or_else(any)?))
    };
    if let Some((part, roles)) = all.iter().filter(called).find_map(roles) {
        let missing = roles.missing();
        if !missing.is_empty() {
            let path = path.display();
            log::warn!("{path}: layer '{layer}' has no channel for {}: taken for 0", missing.join(" and "));
        }
        return Ok((part, roles));
    }
    let deep = headers.iter().find(|h| h.deep && h.own_attributes.layer_name.as_ref().is_some_and(|n| n.eq(layer)));
    if deep.is_some() {
        return Err(Error::unsupported(path, format!("the part '{layer}' is deep; flatten it first")));
    }
    let mut names: Vec<String> = all.iter().map(Layer::name).filter(|n| !n.is_empty()).collect();
    names.sort();
    names.dedup();
    let known = if names.is_empty() { "it has none".to_owned() } else { format!("it has {}", names.join(", ")) };
    Err(Error::Mismatch(format!("{}: no layer '{layer}' with colour; {known}", path.display())))
}
