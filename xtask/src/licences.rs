//! The licences of everything that a default build uses, dependencies of tests and of other platforms included.

use crate::spdx;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// Licences that ask for no more than to be named.
const PERMISSIVE: [&str; 14] = [
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "MIT",
    "MIT-0",
    "Unicode-3.0",
    "Unicode-DFS-2016",
    "Unlicense",
    "Zlib",
];

/// Prints how many crates come under which licence.
///
/// # Errors
/// The crates whose licence is missing, cannot be read or is not permissive.
pub(crate) fn check() -> Result<(), String> {
    let metadata = crate::metadata(&[])?;
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    let mut offenders = Vec::new();
    for (name, licence) in used_packages(&metadata) {
        if let Some(why) = objection(licence) {
            offenders.push(format!("{name}: {why}"));
        }
        *counts.entry(licence.unwrap_or("none").to_owned()).or_default() += 1;
    }
    let mut rows: Vec<_> = counts.into_iter().collect();
    rows.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    for (licence, count) in rows {
        println!("{count:5}  {licence}");
    }
    if offenders.is_empty() {
        Ok(())
    } else {
        Err(format!("not under a permissive licence:\n  {}", offenders.join("\n  ")))
    }
}

/// Name with version, and licence, of the packages that the resolver chose for the default features.
fn used_packages(metadata: &Value) -> Vec<(String, Option<&str>)> {
    let nodes = metadata["resolve"]["nodes"].as_array();
    let chosen: BTreeSet<_> = nodes.into_iter().flatten().filter_map(|node| node["id"].as_str()).collect();
    let packages = metadata["packages"].as_array().into_iter().flatten();
    packages
        .filter(|p| p["id"].as_str().is_some_and(|id| chosen.contains(id)))
        .map(|p| {
            let text = |key: &str| p[key].as_str();
            let name = format!("{} {}", text("name").unwrap_or("?"), text("version").unwrap_or("?"));
            (name, text("license"))
        })
        .collect()
}

fn objection(licence: Option<&str>) -> Option<String> {
    let Some(licence) = licence else {
        return Some("declares none".to_owned());
    };
    match spdx::is_satisfied(licence, &|name| PERMISSIVE.contains(&name)) {
        Ok(true) => None,
        Ok(false) => Some(licence.to_owned()),
        Err(why) => Some(why),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copyleft_and_silence_are_refused() {
        assert_eq!(objection(Some("MIT OR Apache-2.0")), None);
        assert!(objection(Some("LGPL-2.1-only")).is_some());
        assert!(objection(Some("MIT AND GPL-3.0-or-later")).is_some());
        assert!(objection(Some("MIT OR")).is_some());
        assert!(objection(None).is_some());
    }

    #[test]
    fn only_chosen_packages_count() {
        let metadata = serde_json::json!({
            "packages": [
                {"id": "a#1", "name": "a", "version": "1", "license": "MIT"},
                {"id": "b#1", "name": "b", "version": "1", "license": "GPL-3.0-only"},
                {"id": "c#1", "name": "c", "version": "1", "license": null},
            ],
            "resolve": {"nodes": [{"id": "a#1"}, {"id": "c#1"}]},
        });
        assert_eq!(used_packages(&metadata), [("a 1".to_owned(), Some("MIT")), ("c 1".to_owned(), None)]);
    }
}
