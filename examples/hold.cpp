// Hold an object with as little force as is safe, as hold.py does: hold unix://PATH [ENDPOINT]
#include <tactiled.hpp>
#include <tactiled_grip_controller.hpp>

#include "emulated_gripper.hpp"  // replace it by yours: docs/hold.md says what is assumed

int main(int argc, char** argv) {
    EmulatedGripper gripper(argc > 1 ? argv[1] : "gripper");
    tactiled::Subscription events(argc > 2 ? argv[2] : tactiled::DEFAULT_ENDPOINT, {"grip"});
    tactiled::GripController controller;
    tactiled::Grip grip;
    double present_n = gripper.move(controller.command_n());
    for (;;) {
        const tactiled::Item* item = events.next(tactiled::monotonic_s() + 0.1);
        if (!item || item->kind == tactiled::Kind::STALE)
            present_n = gripper.move(controller.blind());
        else if (item->kind == tactiled::Kind::MESSAGE && item->message.read(grip) && events.fresh())
            present_n = gripper.move(controller.take(grip, present_n));
    }
}
