// Sockets of a client: endpoints, keys, clocks, waiting, and one file descriptor for all of them.
//
// Needs Linux, libzmq and cppzmq (4.9).
#pragma once

#include <poll.h>
#include <sys/epoll.h>
#include <sys/stat.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <ctime>
#include <fstream>
#include <initializer_list>
#include <iterator>
#include <optional>
#include <random>
#include <stdexcept>
#include <string>
#include <string_view>
#include <zmq.hpp>

#include "tactiled_inbox.hpp"

namespace tactiled {

// Endpoint of events of a daemon on this host that keeps its defaults.
constexpr const char* DEFAULT_ENDPOINT = "tcp://127.0.0.1:9872";

// A topic, an endpoint or a file of keys is wrong, or a command has no reply; `what()` says what to do.
struct Error : std::runtime_error {
    using std::runtime_error::runtime_error;
};

// Now in seconds of CLOCK_MONOTONIC: for `Subscription::next` and `Message::age_s`.
inline double monotonic_s()
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Now in epoch seconds, as the timestamps of messages.
inline double unix_s()
{
    return std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
}

// Endpoint of commands and of requests for missed messages, by that of events. TCP: the next port. ipc: the same
// folder, where `events` in the name becomes `control`, or `.control` is added. Other transports: empty.
inline std::string control_endpoint(const std::string& endpoint)
{
    if (endpoint.rfind("tcp://", 0) == 0) {
        const std::string port = endpoint.substr(endpoint.rfind(':') + 1);
        if (port.empty() || port.size() > 5 || port.find_first_not_of("0123456789") != std::string::npos)
            return "";
        return endpoint.substr(0, endpoint.rfind(':') + 1) + std::to_string(std::stoi(port) + 1);
    }
    if (endpoint.rfind("ipc://", 0) != 0 || endpoint.size() == 6)
        return "";
    const std::size_t name = std::max<std::size_t>(6, endpoint.rfind('/') + 1);
    std::string control = endpoint;
    std::size_t found = control.find("events", name);
    if (found == std::string::npos)
        return endpoint + ".control";
    for (; found != std::string::npos; found = control.find("events", found + 7))
        control.replace(found, 6, "control");
    return control;
}

// Settings of a Subscription and of a Commander that most programs leave as they are.
struct Options {
    // Serial number of the board to hear; empty for all boards, which must all be fresh.
    std::string board;
    // Silence, or age of the newest status, that is reported as stale: 0.5 s by default.
    double stale_after_s = STALE_AFTER_S;
    // Endpoint of commands and requests, where it is not `control_endpoint` of that of events. With an empty
    // text, a Subscription recovers nothing.
    std::optional<std::string> control;
    std::string keys;  // file of this client from `tactiled keys make`; empty without keys
    std::string who;   // name of this client, for the recording of commands
};

namespace detail {

constexpr int RECEIVE_HIGH_WATER = 2000;  // as the publisher's: a pause of some 18 s loses nothing
constexpr int REQUEST_HIGH_WATER = 64;
constexpr int RECONNECT_MS = 30;  // requests wait for a daemon that restarts; libzmq's default is 100
constexpr std::int64_t LARGEST_BYTES = 1 << 20;  // the largest message has some 40 kB (4096 channels)
constexpr double LONGEST_WAIT_S = 1e6;  // after that, the caller waits again
constexpr double RETRY_S = 0.01;  // interval of sending a request while the socket is not connected

inline std::string random_hex(std::size_t digits)
{
    std::random_device random;
    std::string text;
    while (text.size() < digits)
        text += "0123456789abcdef"[random() & 15];
    return text;
}

// Key under a name in a file of `tactiled keys make`.
inline std::string key_of(const std::string& path, const std::string& text, const std::string& name)
{
    constexpr std::size_t LENGTH = 40;  // of a key in Z85
    const std::string before = "\n" + name + " = \"";
    const std::size_t line = text.find(before), from = line + before.size();
    if (line == std::string::npos || text.find('"', from) != from + LENGTH)
        throw Error(path + " is no file of `tactiled keys make`: " + name + " is missing");
    return text.substr(from, LENGTH);
}

inline void set_keys(zmq::socket_t& socket, const std::string& path)
{
    struct stat about {};
    std::ifstream file(path);
    if (!file || stat(path.c_str(), &about) != 0)
        throw Error(path + ": cannot be read");
    if (about.st_mode & 077)
        throw Error(path + ": others can read the secret key: chmod 600 " + path);
    std::string text = "\n";
    text.append(std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>());
    try {
        socket.set(zmq::sockopt::curve_publickey, key_of(path, text, "public_key"));
        socket.set(zmq::sockopt::curve_secretkey, key_of(path, text, "secret_key"));
        socket.set(zmq::sockopt::curve_serverkey, key_of(path, text, "daemon_key"));
    } catch (const zmq::error_t&) {
        throw Error(path + ": a key is no text in Z85");
    }
}

inline void connect(zmq::socket_t& socket, const std::string& endpoint, const std::string& keys)
{
    socket.set(zmq::sockopt::maxmsgsize, LARGEST_BYTES);
    socket.set(zmq::sockopt::ipv6, true);
    // The kernel detects a lost host within some 4 s. Not heartbeats of ZeroMQ: where a queue is full and the
    // peer dies, libzmq 4.3.5 aborts the whole process.
    socket.set(zmq::sockopt::tcp_keepalive, 1);
    socket.set(zmq::sockopt::tcp_keepalive_idle, 1);  // seconds
    socket.set(zmq::sockopt::tcp_keepalive_intvl, 1);
    socket.set(zmq::sockopt::tcp_keepalive_cnt, 3);
    socket.set(zmq::sockopt::tcp_maxrt, 4000);  // ms for which sent data may stay unacknowledged
    socket.set(zmq::sockopt::linger, 0);
    if (!keys.empty())
        set_keys(socket, keys);
    try {
        socket.connect(endpoint);
    } catch (const zmq::error_t& error) {
        throw Error(endpoint + ": " + error.what() + "; it should look like " + DEFAULT_ENDPOINT);
    }
}

// Socket for requests; it accepts them only while it is connected.
inline zmq::socket_t connect_requests(zmq::context_t& context, const std::string& endpoint,
                                      const std::string& keys)
{
    zmq::socket_t socket(context, zmq::socket_type::dealer);
    socket.set(zmq::sockopt::sndhwm, REQUEST_HIGH_WATER);
    socket.set(zmq::sockopt::rcvhwm, REQUEST_HIGH_WATER);
    socket.set(zmq::sockopt::immediate, true);
    socket.set(zmq::sockopt::reconnect_ivl, RECONNECT_MS);
    connect(socket, endpoint, keys);
    return socket;
}

// Socket for events of some topics and of one board, or of all.
inline zmq::socket_t connect_events(zmq::context_t& context, const std::string& endpoint,
                                    const Wanted& wanted, const std::string& keys)
{
    zmq::socket_t socket(context, zmq::socket_type::sub);
    socket.set(zmq::sockopt::rcvhwm, RECEIVE_HIGH_WATER);
    // The daemon replaces these characters in topics; for other names than ASCII, the inbox alone chooses.
    std::string board = wanted.board;
    const bool is_ascii = std::all_of(board.begin(), board.end(), [](unsigned char c) { return c < 0x80; });
    for (char& c : board)
        if (c < 0x20 || c == 0x7F || std::string_view(" ,;/").find(c) != std::string_view::npos)
            c = '-';
    if (board.empty() || !is_ascii) {
        socket.set(zmq::sockopt::subscribe, "tactile/");
    } else {
        for (const std::string& topic : wanted.topics)
            socket.set(zmq::sockopt::subscribe, "tactile/" + board + "/" + topic);
        socket.set(zmq::sockopt::subscribe, "tactile/" + board + (wanted.topics.empty() ? "/" : "/status"));
        socket.set(zmq::sockopt::subscribe, "tactile/-/status");  // until the daemon has a hello of its board
    }
    connect(socket, endpoint, keys);
    return socket;
}

// Words on an endpoint that does not answer.
inline std::string no_answer(const std::string& endpoint)
{
    struct stat about {};
    if (endpoint.rfind("ipc://", 0) != 0)
        return "no answer; is tactiled running there, and has it the key of this client?";
    if (stat(endpoint.c_str() + 6, &about) != 0)
        return std::string("no answer: ") + std::strerror(errno) + "; is tactiled running there?";
    return "no answer; is tactiled running there?";
}

// Call again what a signal interrupts; nothing here waits.
template <class Call> auto uninterrupted(Call call)
{
    for (;;) {
        try {
            return call();
        } catch (const zmq::error_t& error) {
            if (error.num() != EINTR)
                throw;
        }
    }
}

// Part that has arrived; false for none. ZeroMQ hands over all parts of a message at once.
inline bool take(zmq::socket_t& socket, zmq::message_t& part)
{
    return uninterrupted([&] { return socket.recv(part, zmq::recv_flags::dontwait).has_value(); });
}

// False while the daemon is not connected.
inline bool send(zmq::socket_t& socket, const std::string& payload)
{
    const zmq::const_buffer bytes = zmq::buffer(payload.data(), payload.size());
    return uninterrupted([&] { return socket.send(bytes, zmq::send_flags::dontwait).has_value(); });
}

inline std::string_view view(const zmq::message_t& part) { return {part.data<char>(), part.size()}; }

// Descriptor of a socket that is signalled when something arrives after all was read; -1 without a handle.
inline int fd_of(zmq::socket_t& socket) { return socket.handle() ? socket.get(zmq::sockopt::fd) : -1; }

// Wait for one of the descriptors, of which -1 is none, until an instant at most; false where a signal
// interrupted. Once all was read from a socket, this is enough, and takes less time than the poll of ZeroMQ.
template <std::size_t N> bool wait(pollfd (&waits)[N], double until_s)
{
    const double wait_s = std::min(std::max(until_s - monotonic_s(), 0.0), LONGEST_WAIT_S);
    timespec left{};
    left.tv_sec = static_cast<time_t>(wait_s);
    left.tv_nsec = static_cast<long>(1e9 * (wait_s - std::floor(wait_s)));
    return ppoll(waits, N, &left, nullptr) >= 0;
}

// One file descriptor that is readable when a socket may have something to read, or when an instant has
// passed.
class Descriptor {
public:
    explicit Descriptor(std::initializer_list<int> fds)
        : epoll_(epoll_create1(EPOLL_CLOEXEC)),
          timer_(timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK))
    {
        add(timer_);
        for (const int fd : fds)
            if (fd >= 0)
                add(fd);
    }
    Descriptor(const Descriptor&) = delete;
    Descriptor& operator=(const Descriptor&) = delete;
    ~Descriptor()
    {
        close(timer_);
        close(epoll_);
    }

    int fd() const { return epoll_; }

    void set_deadline(double until_s)
    {
        itimerspec at{};
        if (until_s < INF) {
            const double s = std::max(until_s, 1e-9);  // 0 would disarm the timer
            at.it_value.tv_sec = static_cast<time_t>(s);
            at.it_value.tv_nsec = static_cast<long>(1e9 * (s - std::floor(s)));
        }
        timerfd_settime(timer_, TFD_TIMER_ABSTIME, &at, nullptr);
    }

private:
    void add(int fd)
    {
        epoll_event event{};
        event.events = EPOLLIN;
        if (fd < 0 || epoll_ctl(epoll_, EPOLL_CTL_ADD, fd, &event) != 0)
            throw Error("no file descriptor is left");
    }

    int epoll_, timer_;
};

}  // namespace detail

}  // namespace tactiled
