// Client of C++ in a process: prints a line for each item, and for each reply to a command from its input.
//
//     native_client ENDPOINT next|fd [KEYS [TOPIC...]]    waits in `next`, or for the file descriptor
//
// Input: lines of COMMAND [FIELD NUMBER]. Ends with its input.
#include <poll.h>

#include <algorithm>
#include <iostream>
#include <sstream>
#include <type_traits>

#include "tactiled.hpp"

static_assert(!std::is_constructible_v<tactiled::Subscription, const char*, const char*>, "topics are a list");

static void print(const tactiled::Subscription& events, const tactiled::Item& item)
{
    static const char* const NAMES[] = {"Message", "Recovered", "Lost",     "Restarted",
                                        "Stale",   "Fresh",     "Malformed"};
    static tactiled::Scan scan;
    static tactiled::Grip grip;
    static tactiled::Slip slip;
    std::cout << NAMES[static_cast<int>(item.kind)] << " " << events.fresh();
    if (item.kind == tactiled::Kind::MESSAGE || item.kind == tactiled::Kind::RECOVERED) {
        const tactiled::Message& message = item.message;
        const std::string board = message.board.empty() ? "-" : message.board;
        std::cout << " " << message.topic << " " << board << " " << message.seq << " "
                  << message.age_s(tactiled::monotonic_s());
        if (message.read(scan))
            std::cout << " " << scan.volts.size();
        else if (message.read(grip))
            std::cout << " " << grip.state;
        else if (message.read(slip))
            std::cout << " " << slip.kind;
    } else if (item.kind == tactiled::Kind::LOST) {
        std::cout << " " << item.topic << " " << item.count;
    } else if (item.kind == tactiled::Kind::RESTARTED) {
        std::cout << " " << (item.board.empty() ? "-" : item.board);
    } else {
        std::cout << " " << item.reason;
    }
    std::cout << std::endl;
}

static bool has_input(double wait_s)
{
    pollfd input{0, POLLIN, 0};
    return ::poll(&input, 1, static_cast<int>(1000 * wait_s)) > 0;
}

int main(int argc, char** argv)
{
    tactiled::Options options;
    options.who = "native";
    options.keys = argc > 3 ? argv[3] : "";
    tactiled::Subscription events(argv[1], {argv + std::min(argc, 4), argv + argc}, options);
    tactiled::Commander commander(argv[1], options);
    const bool waits_for_fd = std::string(argv[2]) == "fd";
    std::string line, command, field;
    for (;;) {
        if (waits_for_fd) {
            pollfd waits[] = {{events.fd(), POLLIN, 0}, {commander.fd(), POLLIN, 0}, {0, POLLIN, 0}};
            ::poll(waits, 3, -1);
            while (const tactiled::Item* item = events.poll())
                print(events, *item);
        } else if (const tactiled::Item* item = events.next(tactiled::monotonic_s() + 0.05)) {
            print(events, *item);
        }
        try {
            if (const tactiled::Reply* reply = commander.poll())
                std::cout << "Reply " << reply->ok << " " << reply->reason << std::endl;
        } catch (const tactiled::Error& error) {
            std::cout << "Error " << error.what() << std::endl;
        }
        if (!has_input(0.0))
            continue;
        if (!std::getline(std::cin, line))
            return 0;
        std::istringstream words(line);
        double number = 0.0;
        words >> command;
        if (command == "many") {  // a reply may come while a command is begun
            int answered = 0;
            for (int k = 0; k < 3000; ++k)
                answered += commander.send("inhibit", "duration_s", 0.0).ok;
            std::cout << "Many " << answered << std::endl;
        } else if (words >> field >> number)
            commander.begin(command, field, number);
        else
            commander.begin(command);
    }
}
