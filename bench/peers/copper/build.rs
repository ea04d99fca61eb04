//! Copper's macros keep an index of log messages here.

fn main() {
    if let Ok(directory) = std::env::var("OUT_DIR") {
        println!("cargo:rustc-env=LOG_INDEX_DIR={directory}");
    }
}
