# The same lines stand in the setup.py of every package: colcon builds each package from its own file alone.
from setuptools import find_packages, setup

package_name = "ship_studies"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "*/*.html.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=[
        "setuptools",
        "ship_attitude_star",
        "ship_bags",
        "ship_estimation",
        "ship_geometry",
        "ship_node",
        "ship_replay",
        "ship_simulation",
        "ship_stars",
        "theodolite_calib",
        "PyYAML",
        "matplotlib",
        "numpy",
        "rich",
        "scipy",
    ],
    extras_require={"cluster": ["distributed"], "test": ["pytest"]},
    zip_safe=False,
    maintainer="Ship attitude team",
    maintainer_email="maintainers@example.org",
    description="Studies ashore: layout, design, axis fit, installation, INS noise, campaigns of many bags or seeds.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "layout_study = ship_studies.layout.layout_study_command:main",
            "design_study = ship_studies.design.design_study_command:main",
            "fit_axes = ship_studies.axis_fit.fit_axes_command:main",
            "axis_sightings = ship_studies.axis_fit.axis_sightings_command:main",
            "calibrate_installation = ship_studies.installation.calibrate_installation_command:main",
            "identify_noise = ship_studies.ins_noise.identify_noise_command:main",
            "campaign = ship_studies.campaign.campaign_command:main",
        ],
    },
)
