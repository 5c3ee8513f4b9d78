"""The bodylog command line: one file per command; errors become one line and an exit code here."""

import gc
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress

# Small matrices are faster on one BLAS thread, and one
# thread gives the same bytes on every machine size.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
# the AV1 encoder writes to standard error itself: its errors alone
os.environ.setdefault("SVT_LOG", "1")

_RARELY = 100_000
"""New objects after which they are looked through
for cycles: what is imported has none to be freed.
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with the contract's
    code: 0, 1, 2, 3, 4, 65, 73 or 74; 128 + n for signal n.
    """
    code = 0
    signalled = None
    try:
        from bodylog.runtime import signals

        signalled = signals.received_signal
        _raise_on_signals()
        from bodylog.runtime import malloc, sigbus

        malloc.tune_malloc()
        sigbus.install_sigbus_handler()
        if hasattr(sys.stdout, "reconfigure"):
            # a log may name what this terminal cannot write
            sys.stdout.reconfigure(errors="backslashreplace")
        gc.set_threshold(_RARELY)
        code = run_command(arguments)
        if sigbus.zeroed_pages() and code in (0, 3, 4):
            code = _report_unreadable_result()
    except BaseException as problem:
        if not (signalled and signalled()):
            if not isinstance(problem, KeyboardInterrupt):
                raise
            with suppress(OSError):  # before signals were listened to: nothing was started
                os.write(2, b"bodylog: interrupted; nothing half-written was left\n")
        code = 128 + signal.SIGINT
    if signalled and signalled():
        # an interrupted library may crash while Python finalises
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        signals.end_process(signalled(), quiet=False)
    gc.freeze()  # what is left is looked through once more on the way out, for nothing
    sys.exit(code)


def _raise_on_signals() -> None:
    """Let signals end the command, apart from those that its caller ignores."""
    from bodylog.runtime import signals

    plain = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    if hasattr(signal, "SIGHUP"):  # not on Windows
        plain[signal.SIGHUP] = signal.SIG_DFL
    signals.raise_on_signal(
        *(number for number, default in plain.items() if signal.getsignal(number) is default)
    )


def _report_unreadable_result() -> int:
    """Print that the result is unusable."""
    from bodylog.errors import LogError

    from .output import print_error

    print_error(
        LogError(
            "part of a file could not be read, so the output is wrong; check the disk it is on"
        )
    )
    return LogError.exit_code


def run_command(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    import click

    from bodylog.errors import BodylogError, InputError, WriteError
    from bodylog.io.atomic_files import FULL

    from .commands import NoReader, bodylog
    from .output import print_error, print_line

    try:
        code = bodylog.main(arguments, prog_name="bodylog", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except BodylogError as err:
        print_error(err)
        return err.exit_code
    except click.ClickException as err:
        context = getattr(err, "ctx", None)
        path = context.command_path if context else "bodylog"
        print_line(
            f"bodylog: {' '.join(err.format_message().split()).rstrip('.')}; type: {path} --help",
            err=True,
        )
        return err.exit_code
    except (click.Abort, KeyboardInterrupt):
        print_line("bodylog: interrupted; nothing half-written was left", err=True)
        return 130
    except MemoryError as err:
        print_error(
            MemoryError(f"there is not enough memory ({err}); give a lower --rate or a shorter log")
        )
        return 65
    except NoReader:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as err:
        full = err.errno in FULL
        if err.filename is None and not full:
            raise
        print_error(OSError(f"{os.fsdecode(err.filename or 'output')}: {err.strerror}"))
        return (WriteError if full else InputError).exit_code
