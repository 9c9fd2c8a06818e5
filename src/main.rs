//! Handles Ctrl-C and runs the command line.

use std::process::ExitCode;

use marf_engine::Cancel;

fn main() -> ExitCode {
    quiet_mesa();
    survive_file_limit();
    let cancel = Cancel::default();
    let asked = cancel.clone();
    // The first Ctrl-C asks to stop at the next check. The second stops at once, which the store survives.
    let handler = ctrlc::set_handler(move || {
        if asked.is_set() {
            #[allow(clippy::exit, reason = "the user has asked twice")]
            std::process::exit(130);
        }
        asked.set();
    });
    if let Err(error) = handler {
        marf::terminal::eprint_line(&format!(
            "warning: Ctrl-C stops at once and not at a checkpoint: {error}"
        ));
    }
    marf::cli::main(&cancel)
}

/// Keeps Mesa's device-select layer from looking for a window system, which it reports on stderr where there is none. `--device` chooses
/// among all devices without it.
fn quiet_mesa() {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR");
    if !runtime.is_some_and(|folder| std::path::Path::new(&folder).is_dir()) {
        #[allow(unsafe_code, reason = "no other thread runs yet, as `set_var` wants")]
        unsafe {
            std::env::set_var("NODEVICE_SELECT", "1");
        }
    }
}

/// Keeps the signal of a limit on the size of files from ending the program: the write fails, and its error names the file. A handler, unlike
/// a signal that is ignored, is not passed on to the programs that this one starts.
#[cfg(unix)]
fn survive_file_limit() {
    extern "C" fn do_nothing(_signal: libc::c_int) {}
    let handler: extern "C" fn(libc::c_int) = do_nothing;
    #[allow(
        unsafe_code,
        reason = "the handler does nothing, which is safe in any thread at any time"
    )]
    unsafe {
        libc::signal(libc::SIGXFSZ, handler as libc::sighandler_t);
    }
}

#[cfg(not(unix))]
fn survive_file_limit() {}
