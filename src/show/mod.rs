//! report.html: what ran, what was kept, how good it is.
