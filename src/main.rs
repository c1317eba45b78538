//! The program `visagged`.

fn main() {}
