// Gripper of `tactiled emulate --control`. The answer to a command has the true force, and the forces of all taxels.
#pragma once

#include <sys/socket.h>
#include <sys/un.h>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>

class EmulatedGripper {
public:
    explicit EmulatedGripper(const char* path) {  // PATH, or unix://PATH
        path += std::strncmp(path, "unix://", 7) ? 0 : 7;
        sockaddr_un address{AF_UNIX, {}};
        std::strncpy(address.sun_path, path, sizeof address.sun_path - 1);
        const int fd = socket(AF_UNIX, SOCK_STREAM, 0);
        if (connect(fd, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0) std::perror(path), std::exit(1);
        std::signal(SIGPIPE, SIG_IGN);  // an emulator that is gone gives no answer
        stream_ = fdopen(fd, "r+");
    }

    // Command a force; return the one that is exerted now. Ends the program when the scene is over.
    double move(double force_n) {
        std::fprintf(stream_, "{\"grip_n\": %g}\n", force_n);
        if (!std::fgets(line_, sizeof line_, stream_)) std::puts("no answer from the emulator"), std::exit(1);
        if (std::strstr(line_, "\"fallen\": true")) std::puts("dropped"), std::exit(1);
        const double grip_n = value("\"grip_n\": ");
        if (value("\"scene_s\": ") < value("\"duration_s\": ")) return grip_n;
        std::printf("held with %.1f N\n", grip_n);
        std::exit(0);
    }

private:
    double value(const char* name) const {
        const char* found = std::strstr(line_, name);
        return found ? std::atof(found + std::strlen(name)) : 0.0;
    }

    std::FILE* stream_;
    char line_[1 << 16];
};
