// Receiver of scans for `./run bench native`.
//
//     receive client ENDPOINT COUNT     with tactiled.hpp, each scan read into its structure
//     receive bare ENDPOINT COUNT       with zmq_recv alone, nothing parsed
//     receive force ENDPOINT COUNT      the same for forces
//     receive cost FILE                 plays the scans of a file through the inbox, without sockets
//
// The first three print "ready", then the sequence number and the time of each message in ns of
// CLOCK_MONOTONIC, then the processor time of the process in us. The last prints us of processor time of a
// scan, and allocations of a scan: with new, with malloc.
#include <sys/resource.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <new>

#include "tactiled.hpp"

static std::size_t n_new = 0, n_malloc = 0;

extern "C" void* __real_malloc(std::size_t size);
extern "C" void* __wrap_malloc(std::size_t size)  // of the linker's option --wrap=malloc
{
    ++n_malloc;
    return __real_malloc(size);
}

// Not inlined: gcc then takes malloc and delete, or new and free, for a pair that does not match.
[[gnu::noinline]] void* operator new(std::size_t size)
{
    ++n_new;
    if (void* memory = __real_malloc(size))
        return memory;
    throw std::bad_alloc();
}
[[gnu::noinline]] void operator delete(void* memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

static long long now_ns()
{
    timespec now{};
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

static double processor_us()
{
    rusage used{};
    getrusage(RUSAGE_SELF, &used);
    return 1e6 * static_cast<double>(used.ru_utime.tv_sec + used.ru_stime.tv_sec) +
           static_cast<double>(used.ru_utime.tv_usec + used.ru_stime.tv_usec);
}

struct Receipt {
    long long seq, at_ns;
};

// Take note of a message, and tell the first one.
static void note(std::vector<Receipt>& received, long long seq)
{
    received.push_back({seq, now_ns()});
    if (received.size() == 1)
        std::puts("ready"), std::fflush(stdout);
}

static std::vector<Receipt> with_client(const char* endpoint, std::size_t count)
{
    std::vector<Receipt> received;
    received.reserve(count);
    tactiled::Subscription events(endpoint, {"scan"});
    tactiled::Scan scan;
    while (received.size() < count) {
        const tactiled::Item* item = events.next();
        if (item && item->kind == tactiled::Kind::MESSAGE && item->message.read(scan))
            note(received, scan.seq);
    }
    return received;
}

template <class Event> static std::vector<Receipt> with_zmq_recv(const char* endpoint, std::size_t count)
{
    const std::string name = Event::TOPIC, end = "/" + name;
    std::vector<Receipt> received;
    std::vector<std::string> payloads;  // parsed at the end
    received.reserve(count);
    payloads.reserve(count);
    void* context = zmq_ctx_new();
    void* socket = zmq_socket(context, ZMQ_SUB);
    zmq_setsockopt(socket, ZMQ_SUBSCRIBE, "", 0);
    zmq_connect(socket, endpoint);
    static char topic[256], payload[65536];
    while (received.size() < count) {
        const int topic_size = zmq_recv(socket, topic, sizeof topic, 0);
        const int size = zmq_recv(socket, payload, sizeof payload, 0);
        const std::string_view path(topic, static_cast<std::size_t>(topic_size));
        if (path.size() < end.size() || path.substr(path.size() - end.size()) != end)
            continue;
        note(received, 0);
        payloads.emplace_back(payload, static_cast<std::size_t>(size));
    }
    zmq_close(socket);
    zmq_ctx_term(context);
    tactiled::Message message;
    message.topic = name;
    for (std::size_t n = 0; n < count; ++n) {
        Event event;
        message.payload = payloads[n];
        received[n].seq = message.read(event) ? event.seq : -1;
    }
    return received;
}

// Scans in the file are sizes, each on a line, with payloads behind them.
static void cost(const char* path)
{
    std::ifstream file(path, std::ios::binary);
    std::vector<std::string> payloads;
    for (std::size_t size = 0; file >> size;) {
        file.get();
        std::string payload(size, '\0');
        file.read(payload.data(), static_cast<std::streamsize>(size));
        payloads.push_back(std::move(payload));
    }
    tactiled::Inbox inbox({{"scan"}, ""}, tactiled::STALE_AFTER_S, 0.0, true, "cost");
    tactiled::Items items;
    tactiled::Scan scan;
    std::size_t n_read = 0;
    double from_us = 0.0;
    const std::size_t n_warm = payloads.size() / 10;
    for (std::size_t n = 0; n < payloads.size(); ++n) {
        if (n == n_warm) {
            n_new = n_malloc = n_read = 0;
            from_us = processor_us();
        }
        inbox.receive({2, "tactile/TS0001/scan", payloads[n]}, 1e-6 * static_cast<double>(n), 1.7e9, items);
        while (const tactiled::Item* item = items.take())
            n_read += item->kind == tactiled::Kind::MESSAGE && item->message.read(scan);
    }
    const double scans = static_cast<double>(n_read);
    const double scan_us = (processor_us() - from_us) / scans;
    const double with_new = static_cast<double>(n_new) / scans,
                 with_malloc = static_cast<double>(n_malloc) / scans;
    std::printf("%.4f %.4f %.4f\n", scan_us, with_new, with_malloc);
}

int main(int argc, char** argv)
{
    const std::string mode = argc > 2 ? argv[1] : "";
    if (mode == "cost") {
        cost(argv[2]);
        return 0;
    }
    if (argc != 4)
        return 2;
    const std::size_t count = std::strtoul(argv[3], nullptr, 10);
    const auto receive = mode == "client" ? with_client
                         : mode == "force" ? with_zmq_recv<tactiled::Force>
                                           : with_zmq_recv<tactiled::Scan>;
    const std::vector<Receipt> received = receive(argv[2], count);
    const double used_us = processor_us();
    for (const Receipt& receipt : received)
        std::printf("%lld %lld\n", receipt.seq, receipt.at_ns);
    std::printf("%.1f\n", used_us);
}
