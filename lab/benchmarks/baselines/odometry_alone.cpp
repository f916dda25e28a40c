// odometry-alone: the start that is told, and the odometry from there on. Nothing is learned of where it is not told.
//
// c++ -O2 -std=c++17 -o odometry_alone odometry_alone.cpp
// for folder in inputs/*/; do ./odometry_alone "$folder" > results/odometry-alone/$(basename "$folder").tum; done
#include <cmath>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

struct Pose { double t, x, y, theta; };

static Pose after(const Pose& pose, const Pose& before, const Pose& now) {
    const double dx = now.x - before.x, dy = now.y - before.y, turned = pose.theta - before.theta;
    return {now.t, pose.x + std::cos(turned) * dx - std::sin(turned) * dy,
            pose.y + std::sin(turned) * dx + std::cos(turned) * dy, now.theta + turned};
}

int main(int count, char** words) {
    if (count != 2) return std::fprintf(stderr, "usage: odometry_alone FOLDER\n"), 2;
    const std::string folder = std::string(words[1]) + "/";
    std::ifstream told(folder + "start.tum"), odometry(folder + "odometry.csv"), seen(folder + "observations.csv");
    double t, x, y, z, qx, qy, qz, qw;
    if (!(told >> t >> x >> y >> z >> qx >> qy >> qz >> qw)) return 0;  // no start: no pose
    Pose pose{t, x, y, 2.0 * std::atan2(qz, qw)};
    std::string line, last;
    std::vector<Pose> log;
    std::getline(odometry, line);
    while (std::getline(odometry, line)) {
        Pose row;
        if (std::sscanf(line.c_str(), "%lf,%lf,%lf,%lf", &row.t, &row.x, &row.y, &row.theta) == 4) log.push_back(row);
    }
    std::size_t next = 0;
    bool begun = false;
    Pose before{};
    std::getline(seen, line);
    while (std::getline(seen, line)) {
        const std::string stamp = line.substr(0, line.find(','));
        if (stamp == last) continue;
        last = stamp;
        while (next + 1 < log.size() && log[next + 1].t <= std::stod(stamp)) ++next;
        if (begun) pose = after(pose, before, log[next]);
        begun = true, before = log[next];
        std::printf("%s %.6f %.6f 0 0 0 %.9f %.9f\n", stamp.c_str(), pose.x, pose.y, std::sin(0.5 * pose.theta),
                    std::cos(0.5 * pose.theta));
    }
}
