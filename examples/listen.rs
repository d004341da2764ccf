//! Prints slips as they are told, and when not to trust the sense of touch.
//!
//!     rustc --edition 2021 listen.rs -L /usr/local/lib
//!     ./listen ipc:///run/tactiled/all/events.ipc
use std::ffi::{CStr, CString};
use std::os::raw::{c_char, c_double, c_int}; // also in compilers of 2022
use std::ptr::null;

#[repr(C)]
struct Client {
    _private: [u8; 0],
}

// As in tactiled.h, which says what each does.
#[link(name = "tactiled")]
extern "C" {
    fn tactiled_open(
        endpoint: *const c_char,
        topics: *const c_char,
        board: *const c_char,
        keys: *const c_char,
    ) -> *mut Client;
    fn tactiled_close(client: *mut Client);
    fn tactiled_next(client: *mut Client, wait_s: c_double) -> c_int;
    fn tactiled_is_fresh(client: *const Client) -> c_int;
    fn tactiled_age_s(client: *const Client) -> c_double;
    fn tactiled_number(client: *mut Client, field: *const c_char, value: *mut c_double) -> c_int;
    fn tactiled_text(client: *mut Client, field: *const c_char) -> *const c_char;
    fn tactiled_reason(client: *const Client) -> *const c_char;
    fn tactiled_error() -> *const c_char;
}
const FAILED: c_int = -1;
const MESSAGE: c_int = 1;
const STALE: c_int = 5;

fn owned(text: *const c_char) -> String {
    if text.is_null() {
        return String::new();
    }
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}

/// Slips of one daemon. It is not `Send`: a client belongs to one thread at a time.
struct Slips(*mut Client);

impl Slips {
    fn open(endpoint: &str) -> Result<Self, String> {
        let (endpoint, topics) = (CString::new(endpoint).map_err(|e| e.to_string())?, CString::new("slip").unwrap());
        let client = unsafe { tactiled_open(endpoint.as_ptr(), topics.as_ptr(), null(), null()) };
        if client.is_null() { Err(owned(unsafe { tactiled_error() })) } else { Ok(Slips(client)) }
    }

    fn text(&self, field: &str) -> String {
        let field = CString::new(field).unwrap();
        owned(unsafe { tactiled_text(self.0, field.as_ptr()) })
    }

    /// Whether the newest message may be acted on.
    fn may_act(&self) -> bool {
        let (field, mut is_valid) = (CString::new("valid").unwrap(), 0.0);
        let read = unsafe { tactiled_number(self.0, field.as_ptr(), &mut is_valid) };
        let age_s = unsafe { tactiled_age_s(self.0) };
        read == 0 && is_valid != 0.0 && unsafe { tactiled_is_fresh(self.0) } == 1 && age_s.abs() < 0.2
    }
}

impl Drop for Slips {
    fn drop(&mut self) {
        unsafe { tactiled_close(self.0) }
    }
}

fn main() -> Result<(), String> {
    let endpoint = std::env::args().nth(1).ok_or("usage: listen ENDPOINT")?;
    let slips = Slips::open(&endpoint)?;
    loop {
        match unsafe { tactiled_next(slips.0, -1.0) } {
            FAILED => return Err(owned(unsafe { tactiled_error() })),
            STALE => println!("hold without touch: {}", owned(unsafe { tactiled_reason(slips.0) })),
            MESSAGE if slips.may_act() => println!("{} of a slip, {}", slips.text("state"), slips.text("kind")),
            _ => {}
        }
    }
}
