"""Camera of a star sensor: conversion between pixels and directions, and its errors."""
