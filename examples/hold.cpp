// Hold an object with as little force as is safe, as hold.py does: hold CONTROL_SOCKET [ENDPOINT]
#include <sys/socket.h>
#include <sys/un.h>
#include <cstdio>
#include <cstring>
#include <tactiled.hpp>
#include <tactiled_grip_controller.hpp>

double move(std::FILE* gripper, double force_n) {  // of `tactiled emulate --control`; replace it by yours
    char line[1 << 16] = "";  // the answer has the forces of all taxels
    std::fprintf(gripper, "{\"grip_n\": %g}\n", force_n);
    const char* found = std::fgets(line, sizeof line, gripper) ? std::strstr(line, "\"grip_n\": ") : nullptr;
    return found ? std::atof(found + 10) : force_n;
}

int main(int argc, char** argv) {
    sockaddr_un address{AF_UNIX, {}};
    std::strncpy(address.sun_path, argc > 1 ? argv[1] : "", sizeof address.sun_path - 1);
    const int fd = socket(AF_UNIX, SOCK_STREAM, 0);
    if (connect(fd, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0) return 1;
    std::FILE* gripper = fdopen(fd, "r+");
    tactiled::Subscription events(argc > 2 ? argv[2] : tactiled::DEFAULT_ENDPOINT, {"grip"});
    tactiled::GripController controller;
    tactiled::Grip grip;
    double present_n = move(gripper, controller.command_n());
    while (const tactiled::Item* item = events.next())  // until a signal
        if (item->kind == tactiled::Kind::MESSAGE && item->message.read(grip) && events.fresh())
            present_n = move(gripper, controller.take(grip, present_n));
        else if (item->kind == tactiled::Kind::STALE) present_n = move(gripper, controller.blind());
}
