//! A channel as the stream that axum sends.

use std::pin::Pin;
use std::task::{Context, Poll};

use futures_core::Stream;
use tokio::sync::mpsc::Receiver;

/// Received messages, as a stream that ends with the last sender.
pub struct Received<T> {
    /// The message received already.
    first: Option<T>,
    rest: Receiver<T>,
}

impl<T> Received<T> {
    /// Returns the stream of a channel.
    pub fn new(rest: Receiver<T>) -> Self {
        Self { first: None, rest }
    }

    /// Returns the stream of a channel that something was received from already.
    pub fn after(first: T, rest: Receiver<T>) -> Self {
        let first = Some(first);
        Self { first, rest }
    }
}

// Nothing in it is pinned.
impl<T> Unpin for Received<T> {}

impl<T> Stream for Received<T> {
    type Item = T;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<T>> {
        match self.first.take() {
            Some(first) => Poll::Ready(Some(first)),
            None => self.rest.poll_recv(context),
        }
    }
}
