//! Gives the library the name by which NI's clients look for it.

fn main() {
    println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libnidaqmx.so.1");
}
