//! Archives to photos and labels.
