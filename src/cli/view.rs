//! `marf view`: the report, the progress of a running program and a 3-D view, served on one port.

use std::sync::Arc;

use clap::Args;
use marf_field::Device;
use marf_run::view::StoreSource;
use marf_run::{Context, Error};
use marf_view::{Options, Server};

use super::options::{DeviceArg, StoreArgs, ThreadsArg};
use crate::terminal::{eprint_line, print_line};

/// Arguments of `view`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct ViewArgs {
    /// Number of the run [default: the newest one at each load of the page]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Port, or 0 for a free one
    #[arg(long, value_name = "PORT", default_value_t = 8460)]
    pub port: u16,
    /// Name or address to listen on. An address that other machines can reach needs a token
    #[arg(long, value_name = "HOST", default_value = "127.0.0.1")]
    pub host: String,
    /// Access token, at least 16 letters and digits, which the printed address contains
    #[arg(long, value_name = "TOKEN")]
    pub token: Option<String>,
    /// Path prefix of all pages, for a proxy, e.g. `/mars`
    #[arg(long, value_name = "PATH")]
    pub prefix: Option<String>,
    #[command(flatten)]
    store: StoreArgs,
    #[command(flatten)]
    threads: ThreadsArg,
    #[command(flatten)]
    device: DeviceArg,
}

const AFTER_HELP: &str = "\
The page loads nothing from the network. The store receives splats of the field once a page needs them. From another machine: `ssh -L 8460:127.0.0.1:8460 HOST`, \
then open http://127.0.0.1:8460/ there. The 3-D view is rendered here, on the CPU unless --device names a GPU.";

/// `marf view`: serves until Ctrl-C.
pub fn view(args: ViewArgs, context: Context) -> Result<(), Error> {
    let context = args.threads.context(args.store.context(context));
    let context = args.device.context(context);
    let source = StoreSource::open(&context, args.run)?;
    let options = Options {
        host: args.host,
        port: args.port,
        token: args.token,
        prefix: args.prefix.unwrap_or_default(),
        threads: context.threads,
        device: context.config.device.clone().unwrap_or(Device::Cpu),
    };
    let server = Server::bind(options, Arc::new(source))?;
    print_line(&server.address());
    eprint_line("Ctrl-C stops it");
    Ok(server.serve(|| context.cancel.is_set())?)
}
