//! The committed header is what cbindgen makes of the interface today.

use std::fs;
use std::path::Path;

#[test]
fn the_header_is_that_of_the_interface() {
    let crate_directory = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(crate_directory.join("cbindgen.toml")).unwrap();
    let made = cbindgen::Builder::new()
        .with_src(crate_directory.join("src/abi.rs"))
        .with_config(config)
        .generate();
    let mut text = Vec::new();
    made.unwrap().write(&mut text);
    let committed = crate_directory.join("include/ironbird_law.h");
    if fs::read(&committed).unwrap_or_default() != text {
        let fresh = Path::new(env!("CARGO_TARGET_TMPDIR")).join("ironbird_law.h");
        fs::write(&fresh, text).unwrap();
        panic!(
            "the interface has changed: cp {} {}",
            fresh.display(),
            committed.display()
        );
    }
}
