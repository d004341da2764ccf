// Hold an object with as little force as is safe, as hold.py does: hold unix://PATH [ENDPOINT]
#include <sys/socket.h>
#include <sys/un.h>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <tactiled.hpp>
#include <tactiled_grip_controller.hpp>

double move(std::FILE* gripper, double force_n) {  // of `tactiled emulate --control`; replace it by yours
    static char line[1 << 16];  // the answer has the forces of all taxels
    std::fprintf(gripper, "{\"grip_n\": %g}\n", force_n);
    if (!std::fgets(line, sizeof line, gripper)) std::puts("no answer from the emulator"), std::exit(1);
    const auto value = [](const char* name) {
        const char* found = std::strstr(line, name);
        return found ? std::atof(found + std::strlen(name)) : 0.0;
    };
    if (std::strstr(line, "\"fallen\": true")) std::puts("dropped"), std::exit(1);
    const double grip_n = value("\"grip_n\": ");
    if (value("\"scene_s\": ") >= value("\"duration_s\": ")) std::printf("held with %.1f N\n", grip_n), std::exit(0);
    return grip_n;
}

int main(int argc, char** argv) {
    std::signal(SIGPIPE, SIG_IGN);  // an emulator that is gone shows as an answer that is missing
    const char* path = argc < 2 ? "" : std::strncmp(argv[1], "unix://", 7) ? argv[1] : argv[1] + 7;
    sockaddr_un address{AF_UNIX, {}};
    std::strncpy(address.sun_path, path, sizeof address.sun_path - 1);
    const int fd = socket(AF_UNIX, SOCK_STREAM, 0);
    if (connect(fd, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0) return std::perror(path), 1;
    std::FILE* gripper = fdopen(fd, "r+");
    tactiled::Subscription events(argc > 2 ? argv[2] : tactiled::DEFAULT_ENDPOINT, {"grip"});
    tactiled::GripController controller;
    tactiled::Grip grip;
    double present_n = move(gripper, controller.command_n());
    for (;;) {
        const tactiled::Item* item = events.next(tactiled::monotonic_s() + 0.1);
        if (!item || item->kind == tactiled::Kind::STALE) present_n = move(gripper, controller.blind());
        else if (item->kind == tactiled::Kind::MESSAGE && item->message.read(grip) && events.fresh())
            present_n = move(gripper, controller.take(grip, present_n));
    }
}
